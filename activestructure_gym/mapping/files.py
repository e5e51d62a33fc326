"""Map files of any origin, told apart by what they hold: our npz, SplaTAM's npz, 3DGS PLY."""

from __future__ import annotations

import os
import zipfile
from typing import Literal

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.mapping.gaussian_map import GaussianMap
from activestructure_gym.mapping.ply import read_ply
from activestructure_gym.mapping.splatam_file import read_splatam
from activestructure_gym.ply_header import MAGIC

MapKind = Literal["ply", "splatam", "npz"]


def map_kind(path: str | os.PathLike[str]) -> MapKind:
    """What the file holds, "npz" being ours; raises `InputError` for a file that is none of them."""
    try:
        with open(path, "rb") as file:
            start = file.read(4)
        if start.startswith(MAGIC):
            return "ply"
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                names = set(archive.namelist())
            if "parameters.npy" in names:
                return "npz"
            if "means3D.npy" in names:
                return "splatam"
    except FileNotFoundError:
        raise InputError(f"expected a map, but there is no file '{path}'") from None
    except (OSError, zipfile.BadZipFile) as error:
        raise InputError(f"'{path}' cannot be read: {error}") from error
    hint = "; a .splat, of 8 bits a number, is only written" if str(path).endswith(".splat") else ""
    raise InputError(
        f"'{path}' is no map that is known here: expected a 3DGS PLY, SplaTAM's params.npz, or a run's map.npz{hint}"
    )


def read_map(path: str | os.PathLike[str], world_from_first: np.ndarray | None = None) -> GaussianMap:
    """The Gaussians of a file of any of these kinds; raises `InputError`.

    Parameters
    ----------
    path
        A run's ``map.npz``, a PLY as 3D Gaussian splatting writes it, or SplaTAM's ``params.npz``.
    world_from_first
        [4, 4] where the first camera of a SplaTAM map stands in the world; other kinds do not ask for it.

    Returns
    -------
    GaussianMap
        The Gaussians in the world's frame, metres; without moments.

    Raises
    ------
    InputError
        There is no such file, or it is none of these.

    Examples
    --------
    >>> import tempfile
    >>> gaussians = GaussianMap(4)
    >>> gaussians.append(np.zeros((14, 2), np.float32))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     gaussians.save_npz(f"{folder}/map.npz")
    ...     len(read_map(f"{folder}/map.npz"))
    2
    """
    kind = map_kind(path)
    if kind == "splatam":
        return read_splatam(path, world_from_first)
    return read_ply(path) if kind == "ply" else GaussianMap.load_npz(path)
