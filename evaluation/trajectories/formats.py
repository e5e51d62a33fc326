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
- ``npz``: ``world_from_camera`` [T, 4, 4], as in the ``trajectory.npz`` of a run.
"""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from activestructure_gym.errors import InputError, InputWarning, unknown_name
from activestructure_gym.evaluation.archive import schema
from activestructure_gym.npz import read_npz
from activestructure_gym.scenes.loaders.json_files import read_json
from activestructure_gym.scenes.loaders.pose_text import (
    MAX_COORDINATE_M,
    MAX_POSES,
    lines_of,
    matrices_of,
    numbers_of,
    poses_of_quaternions,
    redwood_poses,
    rigid_poses,
    tum_poses,
)
from activestructure_gym.scenes.loaders.scannet import axis_alignment

Format = Literal["auto", "tum", "nice_slam", "kitti", "replica", "redwood", "habitat", "scannet", "scannetpp", "npz"]
FORMATS: tuple[str, ...] = get_args(Format)
QUATERNIONS = frozenset({"tum", "habitat"})  # formats with quaternions, in the order x y z w
_BY_WIDTH = {8: "tum", 12: "kitti", 16: "nice_slam"}  # format by the number of numbers per line
_WIDTHS = {"tum": 8, "kitti": 12, "nice_slam": 16, "replica": 16}  # numbers per line by format
_SCANNETPP = "pose_intrinsic_imu.json"
_IN_FOLDERS = {
    "nice_slam": "traj.txt",
    "replica": "traj_w_c.txt",
    "redwood": "trajectory.log",
    "scannet": "pose",  # a folder
    "scannetpp": f"iphone/{_SCANNETPP}",
    "npz": "trajectory.npz",
}
_POSES: schema.Check = schema.each(
    schema.table(
        {
            "position": schema.each(schema.number(-MAX_COORDINATE_M, MAX_COORDINATE_M), length=3),
            "rotation": schema.each(schema.number(-2, 2), length=4),
        }
    ),
    least=1,
)


def find_file(place: str | os.PathLike[str], kind: str = "auto") -> tuple[Path, str]:
    """Find the trajectory at ``place``, a file or a folder, and return its path and its format.

    ``kind`` is one of `FORMATS`; "auto" detects the format. The returned path is a file, or for a ScanNet scan the
    folder of its pose files. Raise `InputError` if there is no trajectory.
    """
    if kind not in FORMATS:
        raise unknown_name("trajectory format", kind, FORMATS)
    path = Path(os.path.expanduser(place))
    if path.is_dir() and path.name == _IN_FOLDERS["scannet"] and kind in ("auto", "scannet"):
        return path, "scannet"
    if path.is_dir():
        wanted = _IN_FOLDERS if kind == "auto" else {kind: _IN_FOLDERS.get(kind, "")}
        found = [(path / name, known) for known, name in wanted.items() if name and (path / name).exists()]
        if not found:
            names = ", ".join(name for name in wanted.values() if name) or f"no file that {kind} knows"
            raise InputError(f"the folder '{path}' has no trajectory ({names}); name the file itself")
        return found[0]
    if not path.is_file():
        raise InputError(f"there is no trajectory '{path}'")
    if kind == "auto":
        usual = {".npz": "npz", ".log": "redwood", ".json": "scannetpp" if path.name == _SCANNETPP else "habitat"}
        kind = usual.get(path.suffix.lower()) or _by_width(path)
    if kind == "scannet":
        raise InputError(f"'{path}' is a file; of ScanNet give the scan's folder, or the folder pose in it")
    return path, kind


def read_poses(place: str | os.PathLike[str], kind: str = "auto") -> np.ndarray:  # [T, 4, 4] float64
    """Read the poses of the trajectory at ``place``, without a conversion of their axes.

    ``kind`` is one of `FORMATS`; "auto" detects the format from the file extension or the numbers per line. A matrix
    that is only approximately a rotation, because of few digits, is replaced by the nearest rotation. Raise
    `InputError` if the file cannot be read, or if a pose is not a rigid motion.
    """
    path, kind = find_file(place, kind)
    if kind == "npz":
        poses = np.asarray(arrays_of(path)["world_from_camera"], dtype=np.float64)
    elif kind == "habitat":
        poses = _habitat(path)
    elif kind == "redwood":
        poses = redwood_poses(path)
    elif kind == "scannet":
        poses = _scannet(path)
    elif kind == "scannetpp":
        poses = _scannetpp(path)
    else:
        rows = numbers_of(path)
        if rows.shape[1] != _WIDTHS[kind]:
            raise InputError(
                f"'{path}' has {rows.shape[1]} numbers per line, and {kind} has {_WIDTHS[kind]}: give its --format"
            )
        poses = tum_poses(rows, path) if kind == "tum" else matrices_of(rows)
    if not 1 <= len(poses) <= MAX_POSES:
        raise InputError(f"'{path}' holds {len(poses)} poses, from 1 to {MAX_POSES} are read")
    return rigid_poses(poses, path)


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


def _by_width(path: Path) -> str:
    lines = lines_of(path)
    width = len(lines[0][1]) if lines else 0
    if width not in _BY_WIDTH:
        raise InputError(
            f"'{path}' is no trajectory that is known: expected 8 numbers per line (tum), 12 (kitti) or 16 (nice_slam, "
            f"replica), got {width}"
        )
    return _BY_WIDTH[width]


def _habitat(path: Path) -> np.ndarray:
    try:
        given: list[dict[str, Any]] = schema.read_checked_json(path, _POSES)
    except OSError as error:
        raise InputError(f"'{path}' cannot be read: {error.strerror}") from error
    except ValueError as error:
        wanted = 'a list of {"position": [x, y, z], "rotation": [x, y, z, w]}'
        raise InputError(f"'{path}' is no trajectory of Habitat, {wanted}: {error}") from error
    rotations = np.array([pose["rotation"] for pose in given], dtype=np.float64)
    if not (np.abs(np.linalg.norm(rotations, axis=1) - 1.0) <= 1e-2).all():
        raise InputError(f"'{path}' holds a rotation that is no unit quaternion [x, y, z, w]")
    return poses_of_quaternions(np.array([pose["position"] for pose in given], dtype=np.float64), rotations)


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


def _scannetpp(path: Path) -> np.ndarray:
    wanted = "the poses of a ScanNet++ recording (JSON, a table of frames with aligned_pose)"
    frames = read_json(
        path, wanted, lambda given: [np.array(given[name]["aligned_pose"], dtype=np.float64) for name in sorted(given)]
    )
    if not frames or any(frame.shape != (4, 4) for frame in frames):
        raise InputError(f"'{path}' is not {wanted}: every aligned_pose must be 4 x 4 numbers, and there must be one")
    return _known(np.array(frames), path)


def _known(poses: np.ndarray, path: Path) -> np.ndarray:
    """Return only the finite poses, and warn about the others.

    ScanNet writes infinite poses where tracking was lost. ``path`` is for messages. Raise `InputError` if no pose is
    finite.
    """
    known = np.isfinite(poses).all(axis=(1, 2))
    if not known.any():
        raise InputError(f"none of the {len(poses)} poses of '{path}' is known (all are infinite or no number)")
    if not known.all():
        lost = int((~known).sum())
        warnings.warn(
            f"{lost} of {len(poses)} poses of '{path}' are not known and are left out", InputWarning, stacklevel=2
        )
    return poses[known]
