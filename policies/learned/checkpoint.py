"""Checkpoints: ``NAME.safetensors`` with ``NAME.json`` beside it. Reading the description needs no torch."""

from __future__ import annotations

import glob
import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from activestructure_gym.errors import InputError
from activestructure_gym.files import replaced
from activestructure_gym.policies.learned.config import NetworkConfig

if TYPE_CHECKING:
    from activestructure_gym.policies.learned.network import CandidateNetwork

FORMAT = 1
WEIGHTS = ".safetensors"
_DIGITS = 8
_BEST = "best"  # of a training run's directory
_NO_QUESTION_MARK = "a checkpoint's path may hold no '?', behind which a policy's options begin; rename it"


def find_checkpoint(place: str | os.PathLike[str]) -> Path:
    """The weights' file that ``place`` means: the file, its JSON, its name without an ending, or a training run.

    Raises `InputError` where one of the two files is missing, and for a path that a policy's name cannot hold.
    """
    path = Path(place).expanduser()
    if "?" in str(path.absolute()):
        raise InputError(f"'{path.absolute()}': {_NO_QUESTION_MARK}")
    if path.is_dir():
        path = path / _BEST
    weights = path if path.suffix == WEIGHTS else path.with_suffix("") if path.suffix == ".json" else path
    weights = weights if weights.suffix == WEIGHTS else weights.with_name(weights.name + WEIGHTS)
    for file in (weights, weights.with_suffix(".json")):
        if not file.is_file():
            cut = sorted(path.name for path in path.absolute().parent.glob(f"{glob.escape(path.name)}[?]*"))
            if cut:
                raise InputError(f"'{place}' is no checkpoint, but '{cut[0]}' is there: {_NO_QUESTION_MARK}")
            raise InputError(f"'{place}' is no checkpoint of a learned policy: there is no file '{file}'")
    return weights


def digest(weights: Path) -> str:
    """Eight hex digits over weights and description: a checkpoint that changes is another policy."""
    content = hashlib.sha256(weights.read_bytes())
    content.update(json.dumps(_described(weights)["network"], sort_keys=True).encode())
    return content.hexdigest()[:_DIGITS]


def read_network_config(weights: Path) -> NetworkConfig:
    """The shape of the network, from the description beside the weights."""
    try:
        return NetworkConfig.from_dict(_described(weights)["network"])
    except InputError as error:
        raise InputError(f"'{weights.with_suffix('.json')}' describes no policy of ours: {error}") from error


def save_checkpoint(weights: Path, network: CandidateNetwork, notes: Mapping[str, Any]) -> None:
    """Write both files, each at once; ``notes`` say how it was trained."""
    from safetensors.torch import save

    tensors = {name: tensor.detach().contiguous() for name, tensor in network.state_dict().items()}
    description = {"format": FORMAT, "network": network.config.as_dict(), "trained": dict(notes)}
    _replace(weights, save(tensors))
    text = json.dumps(description, indent=1, allow_nan=False)
    _replace(weights.with_suffix(".json"), (text + "\n").encode())


def load_network(weights: Path) -> CandidateNetwork:
    """The network of a checkpoint; raises `InputError` if weights and description do not fit."""
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    from activestructure_gym.policies.learned.network import CandidateNetwork

    network = CandidateNetwork(read_network_config(weights))
    try:
        network.load_state_dict(load_file(weights))
    except (SafetensorError, RuntimeError, OSError) as error:
        first = str(error).strip().splitlines()[0]
        raise InputError(f"the weights in '{weights}' are not those that its JSON describes: {first}") from error
    return network.eval()


def _described(weights: Path) -> dict[str, Any]:
    file = weights.with_suffix(".json")
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        if content["format"] != FORMAT:
            raise InputError(f"'{file}' has the format {content['format']}, this version reads {FORMAT}")
        if "network" not in content:
            raise KeyError("network")
    except (OSError, KeyError, TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"'{file}' cannot be read as a checkpoint ({type(error).__name__}: {error})") from error
    return content


def _replace(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with replaced(path, durable=True) as file:
        file.write(content)
