"""Test which points of the true surface were visible in the keyframes of an episode, by lines of sight."""

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
    margin: float,  # metres in front of a point in which the mesh does not block the line of sight
) -> np.ndarray:  # [S] bool
    """Return which points were visible in at least one keyframe: in the image, within range, and not occluded.

    ``path`` holds the camera, its range and the poses of the keyframes; the mesh of ``scene`` occludes. Lines of sight
    end exactly at the points, so slanted surfaces are not missed between pixels. Both sides of a surface count as
    visible, as for the observable surface.
    """
    camera, camera_from_world = path.camera, invert_rigid(path.keyframes)

    def in_view(index: int, positions: np.ndarray) -> np.ndarray:
        points = transform_points(camera_from_world[index], positions)
        return camera.in_image(points) & (points[:, 2] <= path.max_range)

    return first_in_sight(scene, points, path.keyframes[:, :3, 3], in_view, margin) >= 0
