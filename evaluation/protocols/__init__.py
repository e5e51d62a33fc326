"""Protocols: what is measured, against what, with which constants. Result files name protocol and parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from activestructure_gym.errors import InputError, unknown_name
from activestructure_gym.evaluation.protocols.activegamer import ActiveGamerProtocol
from activestructure_gym.evaluation.protocols.base import CameraPath, EvaluationProtocol
from activestructure_gym.evaluation.protocols.standard import StandardProtocol, Truth

# By name; the first is the one every run is measured by, others come on top of it.
PROTOCOLS: dict[str, type[StandardProtocol] | type[ActiveGamerProtocol]] = {
    protocol.name: protocol for protocol in (StandardProtocol, ActiveGamerProtocol)
}


def get_protocol(name: str) -> EvaluationProtocol:
    """The protocol of that name with its usual constants.

    Parameters
    ----------
    name
        ``"standard"`` or ``"activegamer"``.

    Returns
    -------
    EvaluationProtocol
        With its usual constants.

    Raises
    ------
    InputError
        There is none of this name.

    Examples
    --------
    >>> get_protocol("standard").version
    5
    """
    if name not in PROTOCOLS:
        raise unknown_name("protocol", name, PROTOCOLS)
    return PROTOCOLS[name]()


def protocol_from(parameters: Mapping[str, Any]) -> EvaluationProtocol:
    """Return the protocol that `parameters()` described; raises `InputError` if no protocol here measures it."""
    values: dict[str, Any] = dict(parameters)
    name, version = values.pop("name", None), values.pop("version", None)
    known = next((entry for entry in PROTOCOLS.values() if (entry.name, entry.version) == (name, version)), None)
    if known is None:
        have = ", ".join(f"'{entry.name}' version {entry.version}" for entry in PROTOCOLS.values())
        raise InputError(
            f"the run was made with protocol '{name}' version {version}, this version knows {have}; run it again"
        )
    try:
        constants: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
        return known(**constants)
    except TypeError as error:
        raise InputError(f"protocol '{name}' version {version} has other parameters here: {error}") from error


__all__ = [
    "PROTOCOLS",
    "ActiveGamerProtocol",
    "CameraPath",
    "EvaluationProtocol",
    "StandardProtocol",
    "Truth",
    "get_protocol",
    "protocol_from",
]
