"""Which planes of the Plane Scene Graph a candidate view would see (V_c^vis of Sec. 3.4)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.planes import PlaneNode
from activestructure_gym.volume import VoxelVolume

NEAREST_M = 0.2  # closer than this a depth sensor returns nothing (method.md 5)
FARTHEST_M = 5.0  # distance gate (method.md 5)
STEEPEST_COSINE = float(np.cos(np.radians(80.0)))  # view-angle filter (method.md 5)
LEAST_SHARE = 0.1  # of a plane's points that must pass for the plane to count as visible
SAMPLES = 16  # points tested per plane, spread evenly over its stored points


def visible_planes(
    planes: Sequence[PlaneNode],  # P planes
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [K, 4, 4]
    volume: VoxelVolume | None = None,
) -> np.ndarray:  # [K, P] bool
    """Frustum culling, distance gating and view-angle filtering, as in the paper; a plane is seen from its own side.

    With a ``volume``, points behind an occupied voxel do not count either (beyond the paper, method.md 5).
    """
    if not len(planes) or not len(world_from_camera):
        return np.zeros((len(world_from_camera), len(planes)), dtype=bool)
    points = np.stack([_spread(plane.points) for plane in planes])  # [P, S, 3]
    normals = np.stack([plane.normal for plane in planes])  # [P, 3]
    seen = cosines_in_view(points, normals, camera, world_from_camera) > 0.0
    if volume is not None and seen.any():
        view, plane, sample = np.nonzero(seen)
        seen[view, plane, sample] = volume.sight_free(world_from_camera[view, :3, 3], points[plane, sample])
    return seen.mean(axis=2) >= LEAST_SHARE


def cosines_in_view(
    points: np.ndarray,  # [P, S, 3] metres, world
    normals: np.ndarray,  # [P, 3] unit, of all S points of a row
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [K, 4, 4]
) -> np.ndarray:  # [K, P, S] float64
    """Cosine between the normal and the line of sight; 0 outside the frustum, the distance gate or the view angle.

    Occlusion is not looked at.
    """
    return _cosines_in_view(
        np.ascontiguousarray(points, dtype=np.float64),
        np.ascontiguousarray(normals, dtype=np.float64),
        np.ascontiguousarray(world_from_camera, dtype=np.float64),
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
        camera.width,
        camera.height,
    )


@kernel
def _cosines_in_view(
    points: np.ndarray,  # [P, S, 3] world
    normals: np.ndarray,  # [P, 3]
    poses: np.ndarray,  # [K, 4, 4] world_from_camera
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    width: int,
    height: int,
) -> np.ndarray:  # [K, P, S]
    """Frustum, distance and view angle of every point from every candidate; asked in every step, hence compiled."""
    cosines = np.zeros((len(poses), points.shape[0], points.shape[1]))
    for k in range(len(poses)):
        pose = poses[k]
        for p in range(points.shape[0]):
            for s in range(points.shape[1]):
                x, y, z = points[p, s, 0] - pose[0, 3], points[p, s, 1] - pose[1, 3], points[p, s, 2] - pose[2, 3]
                depth = pose[0, 2] * x + pose[1, 2] * y + pose[2, 2] * z
                distance = np.sqrt(x * x + y * y + z * z)
                if depth <= 0.0 or distance < NEAREST_M or distance > FARTHEST_M:
                    continue
                u = fx * (pose[0, 0] * x + pose[1, 0] * y + pose[2, 0] * z) / depth + cx
                v = fy * (pose[0, 1] * x + pose[1, 1] * y + pose[2, 1] * z) / depth + cy
                if not (0.0 <= u < width and 0.0 <= v < height):
                    continue
                cosine = -(x * normals[p, 0] + y * normals[p, 1] + z * normals[p, 2]) / distance
                if cosine >= STEEPEST_COSINE:
                    cosines[k, p, s] = cosine
    return cosines


def _spread(points: np.ndarray) -> np.ndarray:  # [N, 3] -> [SAMPLES, 3]
    return points[np.arange(SAMPLES) * (len(points) - 1) // (SAMPLES - 1)]
