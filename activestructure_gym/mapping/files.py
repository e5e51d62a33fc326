"""Read map files. The kind of a file is detected from its content: npz of this package, npz of SplaTAM, or 3DGS PLY."""

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
    """Return the kind of a map file; ``"npz"`` is the ``map.npz`` of this package.

    Raise `InputError` for any other file.
    """
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
    hint = "; .splat files can be written, but not read" if str(path).endswith(".splat") else ""
    raise InputError(f"'{path}' is not a map file: expected a 3DGS PLY, SplaTAM's params.npz, or a run's map.npz{hint}")


def read_map(path: str | os.PathLike[str], world_from_first: np.ndarray | None = None) -> GaussianMap:
    """Read the Gaussians of a map file of any known kind.

    Parameters
    ----------
    path : str or path-like
        The ``map.npz`` of a run, a PLY file of 3D Gaussian splatting, or SplaTAM's ``params.npz``.
    world_from_first : ndarray, optional
        [4, 4] world pose of the first camera of a SplaTAM map; not used for the other kinds.

    Returns
    -------
    GaussianMap
        The Gaussians in the world frame, in metres. Adam moments are 0, except from a ``map.npz``.

    Raises
    ------
    InputError
        The file is missing, damaged, or of an unknown kind.

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
