"""Define evaluation protocols: the metrics of a finished map, their reference data, and their constants.

Result files contain the name and the parameters of the protocol.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import is_dataclass
from typing import Any

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.protocols.activegamer import ActiveGamerProtocol
from activestructure_gym.evaluation.protocols.activesplat import ActiveSplatProtocol
from activestructure_gym.evaluation.protocols.base import CameraPath, EvaluationProtocol
from activestructure_gym.evaluation.protocols.naruto import NarutoProtocol
from activestructure_gym.evaluation.protocols.offline import OfflineProtocol
from activestructure_gym.evaluation.protocols.standard import StandardProtocol, Truth
from activestructure_gym.registry import Registry, refuse_code


def _fits(entry: object) -> bool:
    members = ("name", "version", "parameters", "truth", "evaluate")
    return isinstance(entry, type) and is_dataclass(entry) and all(hasattr(entry, member) for member in members)


# `standard` measures every run; others are measured in addition.
PROTOCOLS: Registry[type[EvaluationProtocol]] = Registry(
    "protocol", "protocols", fits=_fits, wanted="a frozen dataclass with the members of EvaluationProtocol"
)
PROTOCOLS.register("standard")(StandardProtocol)
PROTOCOLS.register("activegamer")(ActiveGamerProtocol)
PROTOCOLS.register("activesplat")(ActiveSplatProtocol)
PROTOCOLS.register("naruto")(NarutoProtocol)
PROTOCOLS.register("offline")(OfflineProtocol)


def get_protocol(name: str) -> EvaluationProtocol:
    """Return the protocol of that name with its default constants.

    Parameters
    ----------
    name
        ``"standard"``, ``"activegamer"``, ``"activesplat"``, ``"naruto"``,
        ``"offline"``, another registered name, or ``"package.module:Class"``.

    Returns
    -------
    EvaluationProtocol
        Its field ``name`` is the given name.

    Raises
    ------
    InputError
        The name is unknown, or not that of a protocol.

    Examples
    --------
    >>> get_protocol("standard").version
    5
    """
    return _named(name, PROTOCOLS.get(name)())


def protocol_from(parameters: Mapping[str, Any], file: object = "") -> EvaluationProtocol:
    """Return the protocol with the ``parameters`` that a result file contains, see `EvaluationProtocol.parameters`.

    ``file`` is the path of the result file, for messages. Raise `InputError` if this version has no such protocol, or
    if the name would import code and the file is not trusted.
    """
    values: dict[str, Any] = dict(parameters)
    name, version = values.pop("name", None), values.pop("version", None)
    if PROTOCOLS.imports(name):
        refuse_code(PROTOCOLS.kind, name, file)
    known = PROTOCOLS.get(name) if PROTOCOLS.imports(name) or name in PROTOCOLS else None
    if known is None or known.version != version:
        have = ", ".join(f"'{entry}' version {PROTOCOLS.get(entry).version}" for entry in PROTOCOLS)
        raise InputError(
            f"the run was made with protocol '{name}' version {version}, this version knows {have}; run it again"
        )
    try:
        constants: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
        return _named(name, known(**constants))
    except TypeError as error:
        raise InputError(f"protocol '{name}' version {version} has other parameters here: {error}") from error


def _named(name: str, protocol: EvaluationProtocol) -> EvaluationProtocol:
    if protocol.name != name:
        object.__setattr__(protocol, "name", name)  # the class of a plug-in does not contain it
    return protocol


__all__ = [
    "PROTOCOLS",
    "ActiveGamerProtocol",
    "CameraPath",
    "EvaluationProtocol",
    "OfflineProtocol",
    "StandardProtocol",
    "Truth",
    "get_protocol",
    "protocol_from",
]
