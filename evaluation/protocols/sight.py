"""What the keyframes of an episode saw of the true surface: lines of sight through the mesh, no matter the map."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from activestructure_gym.geometry import invert_rigid, transform_points

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
    camera = path.camera
    seen = np.zeros(len(points), dtype=bool)
    waiting, places = np.arange(len(points)), np.asarray(points, dtype=np.float32)
    for pose, camera_from_world in zip(path.keyframes, invert_rigid(path.keyframes)):
        x, y, z = transform_points(camera_from_world, places).T
        ahead = (z > 0.0) & (z <= path.max_range)
        depth = np.where(ahead, z, 1.0)
        u, v = camera.fx * x / depth + camera.cx, camera.fy * y / depth + camera.cy
        inside = np.flatnonzero(ahead & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height))
        if len(inside):
            eye = pose[:3, 3].astype(np.float32)
            found = inside[~scene.raycaster.occluded(eye, places[inside], margin=margin)]
            seen[waiting[found]] = True
            left = np.ones(len(waiting), dtype=bool)
            left[found] = False
            waiting, places = waiting[left], places[left]
    return seen
