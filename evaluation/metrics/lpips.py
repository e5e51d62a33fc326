"""Compute LPIPS (learned perceptual image patch similarity, [lpips]) with AlexNet, version 0.1.

The user supplies the weights in two files: torchvision's AlexNet, and the five linear layers of lpips 0.1.4. The files
are identified by their SHA-256. They are searched in ``ASG_LPIPS_WEIGHTS`` (or ``--lpips-weights``), by default among
the checkpoints of torch's hub. Files with another checksum are never used. Without weights LPIPS is not computed.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from activestructure_gym.errors import InputError, short_repr

if TYPE_CHECKING:
    import torch

VARIABLE = "ASG_LPIPS_WEIGHTS"
Distance = Callable[[np.ndarray, np.ndarray], float]


@dataclass(frozen=True)
class WeightFile:
    """Describe a published file of weights."""

    what: str  # description in messages
    usual_name: str  # name under which it is published
    sha256: str
    size: int  # bytes


# The name of torchvision's file contains the first digits of its hash. The second file is `weights/v0.1/alex.pth` of
# the package lpips 0.1.4. Both hashes agree with several public evaluation records.
PUBLISHED = (
    WeightFile(
        "torchvision's AlexNet",
        "alexnet-owt-7be5be79.pth",
        "7be5be791159472b1fbf3c69796f7cb30dca7ad8466c2df70058c37116cdee02",
        244_408_911,
    ),
    WeightFile(
        "the linear layers of lpips 0.1.4 (weights/v0.1)",
        "alex.pth",
        "df73285e35b22355a2df87cdb6b70b343713b667eddbda73e1977e0c860835c0",
        6_009,
    ),
)

# (layer of torchvision's AlexNet, stride, padding, whether max pooling precedes it)
_LAYERS = ((0, 4, 2, False), (3, 1, 2, True), (6, 1, 1, True), (8, 1, 1, False), (10, 1, 1, False))
_SHIFT, _SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)  # normalisation of images in [-1, 1]
_EPSILON = 1e-8  # added to the squared lengths of feature vectors, which are divided by their lengths


class Lpips:
    """Compute the LPIPS distance of two images with the weights of AlexNet (``backbone``) and of lpips (``heads``)."""

    def __init__(self, backbone: dict[str, torch.Tensor], heads: dict[str, torch.Tensor]) -> None:
        import torch

        try:
            self._convolutions = [
                (backbone[f"features.{i}.weight"], backbone[f"features.{i}.bias"]) for i, *_ in _LAYERS
            ]
            self._heads = [heads[f"lin{number}.model.1.weight"] for number in range(len(_LAYERS))]
        except KeyError as error:
            raise InputError(f"the LPIPS weights have no entry {error}; expected the two published files") from None
        self._shift = torch.tensor(_SHIFT).view(1, 3, 1, 1)
        self._scale = torch.tensor(_SCALE).view(1, 3, 1, 1)

    def __call__(self, rendered: np.ndarray, true: np.ndarray) -> float:
        """Return the distance of two images [H, W, 3] in [0, 1]: 0 for equal images, without an upper bound."""
        import torch

        with torch.no_grad():
            both = torch.from_numpy(np.stack([rendered, true]).astype(np.float32)).permute(0, 3, 1, 2)
            total = 0.0
            for features, head in zip(self._features((2.0 * both - 1.0 - self._shift) / self._scale), self._heads):
                unit = features / torch.sqrt(_EPSILON + features.square().sum(dim=1, keepdim=True))
                difference = (unit[:1] - unit[1:]).square()
                total += float(torch.nn.functional.conv2d(difference, head).mean())
        return total

    def _features(self, images: torch.Tensor) -> Iterator[torch.Tensor]:
        from torch.nn import functional

        for (weight, bias), (_, stride, padding, pooled) in zip(self._convolutions, _LAYERS):
            if pooled:
                images = functional.max_pool2d(images, 3, 2)
            images = functional.relu(functional.conv2d(images, weight, bias, stride, padding))
            yield images


def find_weights(place: str | None, expected: tuple[WeightFile, ...] = PUBLISHED) -> tuple[list[Path], str]:
    """Return the files with the expected checksums, and an empty text.

    If a file is missing, return no files, and a text that names the missing files. ``place`` is the folder of the
    files, or one of them. None means the checkpoints of torch's hub. Raise `InputError` if ``place`` does not exist.
    """
    if place is None:
        folder = _hub_directory() / "checkpoints"
    else:
        folder = Path(os.path.expanduser(place))
        if not folder.exists():
            raise InputError(
                f"the LPIPS weights {short_repr(place)} do not exist; give a folder with both files, or one"
            )
        folder = folder if folder.is_dir() else folder.parent
    present = {}
    for path in sorted(folder.glob("*.pth")) if folder.is_dir() else ():
        if path.stat().st_size in {file.size for file in expected}:
            present[_sha256(path)] = path
    missing = [file for file in expected if file.sha256 not in present]
    if missing:
        wanted = " and ".join(f"{file.what} ({file.usual_name}, sha256 {file.sha256[:8]}...)" for file in missing)
        # The reason is stored in results, which must not contain a user's path.
        holder = "the cache of torch's hub" if place is None else f"the folder '{folder.name}'"
        return [], f"weights not supplied: {holder} does not hold {wanted}; --lpips-weights FOLDER takes them"
    return [present[file.sha256] for file in expected], ""


def _hub_directory() -> Path:
    """Return torch's hub directory by torch's documented rule, because importing torch takes seconds."""
    if "torch" in sys.modules:  # `torch.hub.set_dir` may have changed it
        return Path(sys.modules["torch"].hub.get_dir())
    cache = os.getenv("XDG_CACHE_HOME", "~/.cache")
    return Path(os.path.expanduser(os.getenv("TORCH_HOME", os.path.join(cache, "torch")))) / "hub"


def load(paths: list[Path]) -> Lpips:
    """Load the network from its two files; raise `InputError` for files that are not weights.

    Only tensors are unpickled, so a file cannot run code.
    """
    import torch

    content = []
    for path in paths:
        try:
            content.append(torch.load(path, map_location="cpu", weights_only=True))
        except Exception as error:  # torch raises errors of many types
            raise InputError(f"'{path}' cannot be read as weights ({type(error).__name__}: {error})") from error
    return Lpips(*content)


@contextmanager
def measuring(notes: dict[str, str]) -> Iterator[Distance | None]:
    """Yield the function that computes the LPIPS distance of two images [H, W, 3] with values in [0, 1].

    Without weights yield None, and store the reason in ``notes["lpips"]``. Within the block torch uses one thread per
    call: views are measured in parallel threads, and a sum that is split over threads can differ between machines.
    """
    network, reason = _network(os.environ.get(VARIABLE) or None)
    if network is None:
        notes["lpips"] = reason
        yield None
        return
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield network
    finally:
        torch.set_num_threads(threads)


def weights_name() -> str | None:
    """Return the first 8 digits of both SHA-256 checksums for the result file; None without weights."""
    network, _ = _network(os.environ.get(VARIABLE) or None)
    return None if network is None else "+".join(file.sha256[:8] for file in PUBLISHED)


@lru_cache(maxsize=4)
def _network(place: str | None) -> tuple[Lpips | None, str]:
    paths, reason = find_weights(place)
    if not paths and place is not None:
        raise InputError(f"LPIPS: {reason}")
    return (load(paths), "") if paths else (None, reason)


def _sha256(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
