"""Read camera poses from JSON files: nerfstudio, Habitat and ScanNet++."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import schema
from activestructure_gym.evaluation.trajectories.colmap import in_number_order
from activestructure_gym.geometry import invert_rigid
from activestructure_gym.scenes.loaders.json_files import read_json
from activestructure_gym.scenes.loaders.pose_text import (
    MAX_COORDINATE_M,
    matrices_of,
    poses_of_quaternions,
    rigid_poses,
)

_SHAPES = ((4, 4), (3, 4))
_POSES: schema.Check = schema.each(
    schema.table(
        {
            "position": schema.each(schema.number(-MAX_COORDINATE_M, MAX_COORDINATE_M), length=3),
            "rotation": schema.each(schema.number(-2, 2), length=4),
        }
    ),
    least=1,
)


def nerfstudio_poses(path: Path) -> np.ndarray:  # [T, 4, 4]
    """Return the ``transform_matrix`` of every frame in the order of the file names, as nerfstudio sorts them.

    nerfstudio multiplies the original poses by ``applied_transform`` from the left, and then the positions by
    ``applied_scale``. Both are undone. Raise `InputError` if the file has another form.
    """
    wanted = "a transforms.json of nerfstudio (JSON with frames, each with a transform_matrix of 4 x 4 or 3 x 4)"
    frames, applied, scale = read_json(
        path,
        wanted,
        lambda given: (
            [
                (str(frame.get("file_path", "")), np.array(frame["transform_matrix"], dtype=np.float64))
                for frame in given["frames"]
            ],
            np.array(given.get("applied_transform", np.eye(4)), dtype=np.float64),
            float(given.get("applied_scale", 1.0)),
        ),
    )
    if not frames or any(matrix.shape not in _SHAPES for _, matrix in frames):
        raise InputError(f"'{path}' is not {wanted}: at least one frame, and 4 x 4 or 3 x 4 numbers for each")
    matrices = [matrix for _, matrix in sorted(frames, key=lambda frame: in_number_order(frame[0]))]
    poses = np.concatenate([matrices_of(matrix.reshape(1, -1)) for matrix in matrices])
    if applied.shape not in _SHAPES or not 0 < scale < np.inf:
        raise InputError(f"'{path}' needs 4 x 4 or 3 x 4 numbers as applied_transform and a positive applied_scale")
    try:
        original_from_applied = invert_rigid(rigid_poses(matrices_of(applied.reshape(1, -1)), path))
    except InputError as error:
        raise InputError(f"'{path}' has an applied_transform that is not a rotation and a translation") from error
    with np.errstate(all="ignore"):  # poses that are not finite are refused later
        poses[:, :3, 3] /= scale
        return original_from_applied @ poses


def habitat_poses(path: Path) -> np.ndarray:  # [T, 4, 4]
    """Return the poses of a JSON list of positions and rotations; raise `InputError` for another form."""
    try:
        given: list[dict[str, Any]] = schema.read_checked_json(path, _POSES)
    except OSError as error:
        raise InputError(f"'{path}' cannot be read: {error.strerror}") from error
    except ValueError as error:
        wanted = 'a list of {"position": [x, y, z], "rotation": [x, y, z, w]}'
        raise InputError(f"'{path}' is not a trajectory of Habitat, {wanted}: {error}") from error
    rotations = np.array([pose["rotation"] for pose in given], dtype=np.float64)
    positions = np.array([pose["position"] for pose in given], dtype=np.float64)
    return poses_of_quaternions(positions, rotations, path)


def scannetpp_poses(path: Path) -> np.ndarray:  # [T, 4, 4]; infinite where tracking was lost
    """Return the ``aligned_pose`` of every frame of a ScanNet++ recording; raise `InputError` for another form."""
    wanted = "the poses of a ScanNet++ recording (JSON, a table of frames with aligned_pose)"
    frames = read_json(
        path, wanted, lambda given: [np.array(given[name]["aligned_pose"], dtype=np.float64) for name in sorted(given)]
    )
    if not frames or any(frame.shape != (4, 4) for frame in frames):
        raise InputError(f"'{path}' is not {wanted}: every aligned_pose must be 4 x 4 numbers, and there must be one")
    return np.array(frames)
