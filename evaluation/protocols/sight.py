"""What the keyframes of an episode saw of the true surface: lines of sight through the mesh, no matter the map."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from activestructure_gym.geometry import invert_rigid, transform_points
from activestructure_gym.ground_truth.observable import first_in_sight

if TYPE_CHECKING:
    from activestructure_gym.evaluation.protocols.base import CameraPath
    from activestructure_gym.scenes import Scene


def seen_by_keyframes(
    points: np.ndarray,  # [S, 3] metres, on the surface
    path: CameraPath,
    scene: Scene,
    margin: float,  # metres before a point that its line of sight spares
) -> np.ndarray:  # [S] bool
    """Which points any keyframe saw: inside the image, within the sensor's range, and nothing of the mesh before them.

    A line of sight per point has no pixels, so a slanted surface is not lost between two of them. The side of the
    surface does not matter, as for the observable surface itself.
    """
    camera, camera_from_world = path.camera, invert_rigid(path.keyframes)

    def in_view(index: int, positions: np.ndarray) -> np.ndarray:
        x, y, z = transform_points(camera_from_world[index], positions).T
        ahead = (z > 0.0) & (z <= path.max_range)
        depth = np.where(ahead, z, 1.0)
        u, v = camera.fx * x / depth + camera.cx, camera.fy * y / depth + camera.cy
        return ahead & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)

    return first_in_sight(scene, points, path.keyframes[:, :3, 3], in_view, margin) >= 0
