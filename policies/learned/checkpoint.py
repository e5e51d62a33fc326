"""Read and write checkpoints: weights in ``NAME.safetensors``, their description in ``NAME.json``.

Reading the description does not load torch.
"""

from __future__ import annotations

import glob
import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.files import replaced
from activestructure_gym.policies.learned.config import NetworkConfig
from activestructure_gym.registry import refuse_code

if TYPE_CHECKING:
    import torch

    from activestructure_gym.policies.learned.network import CandidateNetwork

FORMAT = 1
MAX_WEIGHT_BYTES = 256 << 20  # maximum size of the weights' file, bytes
_MAX_HEADER_BYTES = 1 << 20  # maximum size of the tensors' names and shapes, bytes
_MAX_DESCRIPTION_BYTES = 4 << 20  # maximum size of the JSON file, bytes
WEIGHTS = ".safetensors"
_DIGITS = 8  # number of hex digits of a checkpoint's hash
_BEST = "best"  # file name without suffix of the checkpoint in a folder, such as a training run's directory
_NO_QUESTION_MARK = "a checkpoint's path may hold no '?', behind which a policy's options begin; rename it"


def find_checkpoint(place: str | os.PathLike[str]) -> Path:
    """Return the path of the weights' file of a checkpoint.

    ``place`` is the file, its JSON file, its name without suffix, or its folder. Raises `InputError` if one of the two
    files is missing, or if the path contains a '?'.
    """
    path = Path(os.path.expanduser(place))
    weights = weights_at(path)
    for file in (weights, weights.with_suffix(".json")):
        if not file.is_file():
            cut = sorted(path.name for path in path.absolute().parent.glob(f"{glob.escape(path.name)}[?]*"))
            if cut:
                raise InputError(f"'{place}' is not a checkpoint, but '{cut[0]}' is there: {_NO_QUESTION_MARK}")
            hint = "; a model of stable-baselines3 becomes one by model.policy.save_learned(PLACE)"
            raise InputError(
                f"'{place}' is not a checkpoint of a learned policy: it is not a folder that asg train wrote, and "
                f"there is no file '{file}'{hint if path.suffix == '.zip' else ''}"
            )
    return weights


def weights_at(place: str | os.PathLike[str]) -> Path:
    """Return the path of the weights' file of the checkpoint ``place``, which need not exist.

    ``place`` is the file, its JSON file, its name without suffix, or an existing folder, in which the checkpoint is
    named ``best``. Raises `InputError` for a path with a '?'.
    """
    path = Path(os.path.expanduser(place))
    if "?" in str(path.absolute()):
        raise InputError(f"'{path.absolute()}': {_NO_QUESTION_MARK}")
    if path.is_dir():
        path = path / _BEST
    if path.suffix == WEIGHTS:
        return path
    return path.with_suffix(WEIGHTS) if path.suffix == ".json" else path.with_name(path.name + WEIGHTS)


def digest(weights: Path) -> str:
    """Return a hash of the weights and the network's configuration in eight hex digits.

    It identifies the policy in recorded runs. ``weights`` is the file of the weights.
    """
    check_size(weights)
    content = hashlib.sha256(weights.read_bytes())
    content.update(json.dumps(_described(weights)["network"], sort_keys=True).encode())
    return content.hexdigest()[:_DIGITS]


def check_size(file: Path, most: int = MAX_WEIGHT_BYTES) -> None:
    """Raise `InputError` for a file of more than ``most`` bytes."""
    size = file.stat().st_size
    if size > most:
        raise InputError(f"'{file}' has {size:,} bytes, a checkpoint has at most {most:,}")


def read_network_config(weights: Path) -> NetworkConfig:
    """Return the network's configuration from the description next to the weights.

    Raises `InputError` for an invalid description, and for feature names that would import Python code.
    """
    file = weights.with_suffix(".json")
    content = _described(weights)["network"]
    try:
        config = NetworkConfig.from_dict(content)
    except InputError as error:
        raise InputError(f"'{file}' does not describe a learned policy: {error}") from error
    for name in config.features:
        if ":" in name:  # no registered feature has a colon in its name
            refuse_code("feature", name, file)
    return config


def save_checkpoint(weights: Path, network: CandidateNetwork, notes: Mapping[str, Any]) -> None:
    """Write the checkpoint of ``network``: the file ``weights`` and its JSON description, each atomically.

    ``notes`` describe the training and are stored in the description.
    """
    from safetensors.torch import save

    tensors = {name: tensor.detach().contiguous() for name, tensor in network.state_dict().items()}
    description = {"format": FORMAT, "network": network.config.as_dict(), "trained": dict(notes)}
    _replace(weights, save(tensors))
    text = json.dumps(description, indent=1, allow_nan=False)
    _replace(weights.with_suffix(".json"), (text + "\n").encode())


def load_network(weights: Path) -> CandidateNetwork:
    """Return the network of a checkpoint; raise `InputError` if weights and description do not match."""
    from activestructure_gym.policies.learned.network import CandidateNetwork

    network = CandidateNetwork(read_network_config(weights))
    expected = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    try:
        network.load_state_dict(read_tensors(weights, expected)[0])
    except InputError as error:
        raise InputError(f"{error}; its JSON describes other weights, or one of the two is damaged") from error
    return network.eval()


def read_tensors(
    file: Path,
    expected: Mapping[str, tuple[int, ...]] | None = None,  # shapes by name that the file must have; None for any
    *,
    most: int = MAX_WEIGHT_BYTES,  # maximum size of the file, bytes
) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
    """Return the tensors of a safetensors file by name, and its metadata.

    Raises `InputError` for a damaged or too large file, and for tensors that have other shapes than ``expected``, that
    are not float32, or that contain values that are not finite.
    """
    import torch
    from safetensors import SafetensorError, safe_open

    check_size(file, most)
    with open(file, "rb") as stream:
        header = int.from_bytes(stream.read(8), "little")
    if header > _MAX_HEADER_BYTES:
        raise InputError(f"'{file}' is not a whole safetensors file: its header would have {header:,} bytes")
    try:
        with safe_open(file, "pt") as stored:
            slices = {name: stored.get_slice(name) for name in stored.keys()}
            for name, tensor in slices.items():
                if (dtype := tensor.get_dtype()) != "F32":
                    raise InputError(f"'{file}' holds {dtype} as '{name[:80]}', expected F32")
            shapes = {name: tuple(tensor.get_shape()) for name, tensor in slices.items()}
            wanted = shapes if expected is None else expected
            for name in sorted(wanted.keys() | shapes.keys()):
                if shapes.get(name) != wanted.get(name):
                    have, want = shapes.get(name, "nothing"), wanted.get(name, "nothing")
                    raise InputError(f"'{file}': the tensor '{name[:80]}' has shape {have}, expected {want}")
            tensors = {name: stored.get_tensor(name) for name in shapes}
            notes = dict(stored.metadata() or {})
    except (SafetensorError, OSError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"'{file}' is not a whole safetensors file ({reason})") from error
    for name, tensor in tensors.items():
        if not torch.isfinite(tensor).all():
            raise InputError(f"'{file}' holds numbers in '{name[:80]}' that are not finite")
    return tensors, notes


def _described(weights: Path) -> dict[str, Any]:
    """Return the content of the JSON file next to ``weights``; raise `InputError` unless it describes a checkpoint."""
    file = weights.with_suffix(".json")
    try:
        check_size(file, _MAX_DESCRIPTION_BYTES)
        content = json.loads(file.read_text(encoding="utf-8"))
    except InputError:
        raise
    except (OSError, ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"'{file}' cannot be read as the description of a checkpoint: {reason}") from error
    if not isinstance(content, dict) or not {"format", "network"} <= content.keys():
        raise InputError(f"'{file}' cannot be read as the description of a checkpoint: it lacks format or network")
    if content["format"] != FORMAT:
        raise InputError(f"'{file}' has the format {short_repr(content['format'])}, this version reads {FORMAT}")
    return content


def _replace(path: Path, content: bytes) -> None:
    """Replace the file ``path`` by ``content`` atomically; create its folder if needed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replaced(path, durable=True) as file:
        file.write(content)
