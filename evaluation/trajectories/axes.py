"""Convert camera poses from named conventions of axes to this project's convention.

The camera of this project has x to the right, y down and z forward, and its world has z up. The conventions are:

- ``opencv``: camera x right, y down, z forward; the scene's world, z up;
- ``opengl``: camera x right, y up, z backward; the scene's world, z up;
- ``habitat``: camera x right, y up, z backward; world y up, (x, y, z) becomes (x, -z, y);
- ``ros``: camera x forward, y left, z up; the scene's world, z up.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from activestructure_gym.errors import unknown_name
from activestructure_gym.geometry import invert_rigid

Axes = Literal["opencv", "opengl", "habitat", "ros"]
AXES: tuple[str, ...] = get_args(Axes)
USUAL = {"habitat": "habitat", "nerfstudio": "opengl"}  # default by format; that of all other formats is "opencv"

# Rotations [3, 3] from this project's camera frame to the camera frame of each convention.
_OPENGL = np.diag([1.0, -1.0, -1.0])
_ROS = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_THEIRS_FROM_OURS = {"opencv": np.eye(3), "opengl": _OPENGL, "habitat": _OPENGL, "ros": _ROS}
_UP_FROM_HABITAT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # world y up to z up


def in_our_axes(
    poses: np.ndarray,  # [T, 4, 4] as read from a file: world_from_camera, or camera_from_world if ``inverted``
    axes: str,
    *,
    inverted: bool = False,
) -> np.ndarray:  # [T, 4, 4] world_from_camera
    """Convert poses in the convention ``axes`` to this project's convention.

    Poses of "opencv" that are not inverted are copied unchanged. Raise `InputError` if ``axes`` is not one of `AXES`.
    """
    if axes not in AXES:
        raise unknown_name("axes convention", axes, AXES)
    poses = invert_rigid(poses) if inverted else np.array(poses, dtype=np.float64)
    if axes == "opencv":
        return poses
    poses[:, :3, :3] = poses[:, :3, :3] @ _THEIRS_FROM_OURS[axes]
    if axes == "habitat":
        poses[:, :3, :] = _UP_FROM_HABITAT @ poses[:, :3, :]
    return poses


def begun_at(
    poses: np.ndarray,  # [T, 4, 4] world_from_camera, in any world frame
    start: np.ndarray,  # [4, 4] world_from_camera, in the frame of the scene
) -> np.ndarray:  # [T, 4, 4] world_from_camera, in the frame of the scene
    """Move a trajectory rigidly such that its first pose becomes ``start``.

    This is for files whose world frame is the first camera's frame.
    """
    moved = (start @ invert_rigid(poses[0])) @ poses
    moved[0] = start
    return moved
