"""Read camera poses from files of other programs, without a conversion of their axes.

- ``tum``: ``timestamp tx ty tz qx qy qz qw`` per line, ``#`` before comments ([tum_rgbd], file formats).
- ``nice_slam``: 16 numbers per line, a 4 x 4 matrix row by row; or the folder with ``traj.txt`` ([nice_slam, code]).
- ``kitti``: 12 numbers per line, the upper 3 rows of the matrix ([kitti], odometry).
- ``replica``: 16 numbers per line; or the folder with ``traj_w_c.txt`` ([semantic_nerf, code]).
- ``redwood``: a line of 3 numbers, then a 4 x 4 matrix in 4 lines, for each pose (``.log`` files of [choi2015] and
  Open3D); or the folder with ``trajectory.log``.
- ``habitat``: JSON, a list of ``{"position": [x, y, z], "rotation": [x, y, z, w]}``; poses of the camera, not of the
  body.
- ``scannet``: the folder ``pose`` of a scan, with a 4 x 4 matrix in every ``<number>.txt`` ([scannet], its reader of
  .sens). The scan's axisAlignment is applied to the poses, as it is to the mesh.
- ``scannetpp``: ``iphone/pose_intrinsic_imu.json``, the ``aligned_pose`` of every frame; or the scene's folder
  ([scannetpp], its toolkit).
- ``nerfstudio``: ``transforms.json``, the ``transform_matrix`` of every frame, camera to world with OpenGL axes
  ([nerfstudio], data conventions); instant-ngp writes the same file.
- ``colmap``: ``images.txt`` or ``images.bin``; or the folder of a model (see `colmap`).
- ``euroc``, ``ros_csv``: csv files with named columns (see `pose_tables`).
- ``npz``: ``world_from_camera`` [T, 4, 4], as in the ``trajectory.npz`` of a run.
"""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from activestructure_gym.errors import InputError, InputWarning, unknown_name
from activestructure_gym.evaluation.trajectories.colmap import colmap_poses
from activestructure_gym.evaluation.trajectories.json_poses import habitat_poses, nerfstudio_poses, scannetpp_poses
from activestructure_gym.evaluation.trajectories.pose_tables import seconds_of, table_rows
from activestructure_gym.evaluation.trajectories.recognise import recognised
from activestructure_gym.npz import read_npz
from activestructure_gym.scenes.loaders.pose_text import (
    MAX_POSES,
    matrices_of,
    numbers_of,
    redwood_poses,
    rigid_poses,
    tum_poses,
)
from activestructure_gym.scenes.loaders.scannet import axis_alignment

Format = Literal[
    "auto", "tum", "nice_slam", "kitti", "replica", "redwood", "nerfstudio", "colmap", "euroc", "ros_csv", "habitat",
    "scannet", "scannetpp", "npz",
]  # fmt: skip
FORMATS: tuple[str, ...] = get_args(Format)
QUATERNIONS = frozenset({"tum", "habitat"})  # formats with quaternions, in the order x y z w, without named columns
_WIDTHS = {"tum": 8, "kitti": 12, "nice_slam": 16, "replica": 16}  # numbers per line by format
_READERS = {
    "nerfstudio": nerfstudio_poses,
    "habitat": habitat_poses,
    "scannetpp": scannetpp_poses,
    "colmap": colmap_poses,
    "redwood": redwood_poses,
}
_IN_FOLDERS = (  # in the order of the search
    ("traj.txt", "nice_slam"),
    ("traj_w_c.txt", "replica"),
    ("trajectory.log", "redwood"),
    ("pose", "scannet"),  # a folder
    ("iphone/pose_intrinsic_imu.json", "scannetpp"),
    ("trajectory.npz", "npz"),
    ("transforms.json", "nerfstudio"),
    *((f"{folder}images.{ending}", "colmap") for folder in ("", "sparse/0/", "sparse/") for ending in ("bin", "txt")),
)


@dataclass(frozen=True)
class RecordedPoses:
    """Hold the poses of a file, without a conversion of their axes, and their time stamps."""

    poses: np.ndarray  # [T, 4, 4] float64
    stamps: np.ndarray | None = None  # [T] seconds; None if the file has none


def find_file(place: str | os.PathLike[str], kind: str = "auto") -> tuple[Path, str]:
    """Find the trajectory at ``place``, a file or a folder, and return its path and its format.

    ``kind`` is one of `FORMATS`; "auto" detects the format. The returned path is a file, or for a ScanNet scan the
    folder of its pose files. Raise `InputError` if there is no trajectory.
    """
    if kind not in FORMATS:
        raise unknown_name("trajectory format", kind, FORMATS)
    path = Path(os.path.expanduser(place))
    if path.is_dir() and path.name == "pose" and kind in ("auto", "scannet"):
        return path, "scannet"
    if path.is_dir():
        wanted = [(name, known) for name, known in _IN_FOLDERS if kind in ("auto", known)]
        found = [(path / name, known) for name, known in wanted if (path / name).exists()]
        if not found:
            names = ", ".join(name for name, _ in wanted) or f"{kind} is not a format of a folder"
            raise InputError(f"the folder '{path}' has no trajectory ({names}); name the file itself")
        return found[0]
    if not path.is_file():
        raise InputError(f"there is no trajectory '{path}'")
    if kind == "auto":
        kind = recognised(path)
    if kind == "scannet":
        raise InputError(f"'{path}' is a file; for ScanNet give the scan's folder, or its folder pose")
    return path, kind


def read_poses(place: str | os.PathLike[str], kind: str = "auto") -> np.ndarray:  # [T, 4, 4] float64
    """Read the poses of the trajectory at ``place``, as `read_recorded` does, without their time stamps."""
    return read_recorded(place, kind).poses


def read_recorded(place: str | os.PathLike[str], kind: str = "auto") -> RecordedPoses:
    """Read the poses of the trajectory at ``place`` and their time stamps, without a conversion of the axes.

    ``kind`` is one of `FORMATS`; "auto" recognises the format by the content. A matrix that is only approximately a
    rotation, because of few digits, is replaced by the nearest rotation. Raise `InputError` if the file cannot be read,
    or if a pose is not a rigid motion.
    """
    path, kind = find_file(place, kind)
    try:
        recorded = _read(path, kind)
        if not 1 <= len(recorded.poses) <= MAX_POSES:
            raise InputError(f"'{path}' holds {len(recorded.poses)} poses, from 1 to {MAX_POSES} are read")
        return replace(recorded, poses=rigid_poses(recorded.poses, path))
    except InputError as error:
        raise InputError(f"{error} (read as {kind})") from error


def _read(path: Path, kind: str) -> RecordedPoses:
    """Read the poses of a file as written, and its time stamps."""
    stamps = None
    if kind == "npz":
        poses = np.asarray(arrays_of(path)["world_from_camera"], dtype=np.float64)
    elif kind == "scannet":
        poses = _scannet(path)
    elif kind in _READERS:
        poses = _READERS[kind](path)
    else:
        rows, timed = table_rows(path, kind) if kind in ("euroc", "ros_csv") else (numbers_of(path), kind == "tum")
        if rows.shape[1] != _WIDTHS.get(kind, 8):
            raise InputError(
                f"'{path}' has {rows.shape[1]} numbers per line, and {kind} has {_WIDTHS[kind]}: give its --format"
            )
        if kind == "tum":
            rows[:, 0] = seconds_of(rows[:, 0])
        poses = matrices_of(rows) if kind in ("kitti", "nice_slam", "replica") else tum_poses(rows, path)
        stamps = rows[:, 0] if timed else None
    if kind == "scannetpp":
        poses = _known(poses, path)
    return RecordedPoses(poses, stamps)


def arrays_of(path: Path) -> dict[str, np.ndarray]:
    """Return all arrays of a ``trajectory.npz`` by name; raise `InputError` if it cannot be read or has no poses."""
    try:
        arrays = read_npz(path)
    except OSError as error:
        raise InputError(f"'{path}' cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"'{path}' cannot be read as a trajectory.npz: {error}") from error
    poses = arrays.get("world_from_camera")
    if poses is None or poses.ndim != 3 or poses.shape[1:] != (4, 4) or poses.dtype.kind not in "fiu":
        raise InputError(f"'{path}' holds no array world_from_camera [T, 4, 4]")
    return arrays


def pose_files(folder: Path) -> list[Path]:
    """Return the files ``<number>.txt`` in the ``pose`` folder of a ScanNet scan by number, at most `MAX_POSES` + 1."""
    numbered = {int(file.stem): file for file in folder.glob("*.txt") if file.stem.isascii() and file.stem.isdigit()}
    return [numbered[number] for number in sorted(numbered)][: MAX_POSES + 1]


def scan_text(folder: Path) -> Path:
    """Return the path of a ScanNet scan's text file with the axis alignment, given the scan's folder of poses."""
    # abspath does not follow symbolic links: if the folder is a link, the scan's other files are next to the link.
    scan = Path(os.path.abspath(folder)).parent
    return scan / f"{scan.name}.txt"


def _scannet(folder: Path) -> np.ndarray:
    rows = []
    for file in pose_files(folder):
        numbers = numbers_of(file).ravel()
        if len(numbers) != 16:
            raise InputError(f"'{file}' must hold 16 numbers, a pose row by row, got {len(numbers)}")
        rows.append(numbers)
    if not rows:
        raise InputError(f"'{folder}' holds no pose: expected files 0.txt, 1.txt, ...")
    poses = _known(np.array(rows).reshape(-1, 4, 4), folder)
    return axis_alignment(scan_text(folder)) @ poses


def _known(poses: np.ndarray, path: Path) -> np.ndarray:
    """Return only the finite poses, and warn about the others.

    ScanNet writes infinite poses where tracking was lost. ``path`` is for messages. Raise `InputError` if no pose is
    finite.
    """
    known = np.isfinite(poses).all(axis=(1, 2))
    if not known.any():
        raise InputError(f"none of the {len(poses)} poses of '{path}' is finite")
    if not known.all():
        lost = int((~known).sum())
        warnings.warn(
            f"{lost} of {len(poses)} poses of '{path}' are not finite and are left out", InputWarning, stacklevel=2
        )
    return poses[known]
