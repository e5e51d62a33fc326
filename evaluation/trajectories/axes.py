"""Conventions of axes by name, turned into ours: x right, y down, z forward in the camera, z up in the world.

======== ==================================== ====================================
name     camera                               world
======== ==================================== ====================================
opencv   x right, y down, z forward           the scene's own, z up
opengl   x right, y up, z backward            the scene's own, z up
habitat  x right, y up, z backward            y up, -z forward: (x, z, -y) of ours
ros      x forward, y left, z up              the scene's own, z up
======== ==================================== ====================================
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from activestructure_gym.errors import unknown_name
from activestructure_gym.geometry import invert_rigid

Axes = Literal["opencv", "opengl", "habitat", "ros"]
AXES: tuple[str, ...] = get_args(Axes)
USUAL = {"habitat": "habitat"}  # by format; all others have OpenCV's

# Columns are our camera's axes in theirs.
_OPENGL = np.diag([1.0, -1.0, -1.0])
_ROS = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_THEIRS_FROM_OURS = {"opencv": np.eye(3), "opengl": _OPENGL, "habitat": _OPENGL, "ros": _ROS}
_UP_FROM_HABITAT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # (x, y, z) to (x, -z, y)


def in_our_axes(
    poses: np.ndarray,  # [T, 4, 4] as a file has them
    axes: str,
    *,
    inverted: bool = False,  # the file maps world to camera
) -> np.ndarray:  # [T, 4, 4] world_from_camera
    """The poses in this project's axes, to the last bit where they have them already; `InputError` for a name."""
    if axes not in AXES:
        raise unknown_name("convention of axes", axes, AXES)
    poses = invert_rigid(poses) if inverted else np.array(poses, dtype=np.float64)
    if axes == "opencv":
        return poses
    poses[:, :3, :3] = poses[:, :3, :3] @ _THEIRS_FROM_OURS[axes]
    if axes == "habitat":
        poses[:, :3, :] = _UP_FROM_HABITAT @ poses[:, :3, :]
    return poses


def begun_at(
    poses: np.ndarray,  # [T, 4, 4] world_from_camera of any world
    start: np.ndarray,  # [4, 4] world_from_camera
) -> np.ndarray:  # [T, 4, 4]
    """The same motion, begun at ``start``: for files whose world is their first camera."""
    moved = (start @ invert_rigid(poses[0])) @ poses
    moved[0] = start
    return moved
