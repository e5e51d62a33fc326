"""Map files of any origin, told apart by what they hold: our npz, SplaTAM's npz, 3DGS PLY."""

from __future__ import annotations

import os

from activestructure_gym.errors import InputError
from activestructure_gym.mapping.gaussian_map import GaussianMap
from activestructure_gym.mapping.ply import read_ply


def read_map(path: str | os.PathLike[str]) -> GaussianMap:
    """The Gaussians of a file; raises `InputError` if it is none that is known."""
    try:
        with open(path, "rb") as file:
            start = file.read(4)
    except FileNotFoundError:
        raise InputError(f"expected a map, but there is no file '{path}'") from None
    except OSError as error:
        raise InputError(f"'{path}' cannot be read: {error.strerror}") from error
    if start[:3] == b"ply":
        return read_ply(path)
    return GaussianMap.load_npz(path)
