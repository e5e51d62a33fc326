"""Which planes of the Plane Scene Graph a candidate view would see (V_c^vis of Sec. 3.4)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from activestructure_gym.geometry import PinholeCamera, invert_rigid
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
    eyes = world_from_camera[:, None, None, :3, 3]
    camera_from_world = invert_rigid(world_from_camera)
    local = np.einsum("kij,psj->kpsi", camera_from_world[:, :3, :3], points) + camera_from_world[:, None, None, :3, 3]
    distance = np.linalg.norm(local, axis=-1)  # [K, P, S]
    in_range = (local[..., 2] > 0) & (distance >= NEAREST_M) & (distance <= FARTHEST_M)
    pixels = camera.project(np.where(in_range[..., None], local, 1.0))
    inside = (pixels >= 0).all(-1) & (pixels[..., 0] < camera.width) & (pixels[..., 1] < camera.height)
    cosine = np.einsum("kpsi,pi->kps", eyes - points, normals) / np.maximum(distance, 1e-9)
    seen = in_range & inside & (cosine >= STEEPEST_COSINE)
    if volume is not None and seen.any():
        view, plane, sample = np.nonzero(seen)
        seen[view, plane, sample] = volume.sight_free(world_from_camera[view, :3, 3], points[plane, sample])
    return seen.mean(axis=2) >= LEAST_SHARE


def _spread(points: np.ndarray) -> np.ndarray:  # [N, 3] -> [SAMPLES, 3]
    return points[np.linspace(0, len(points) - 1, SAMPLES).astype(int)]
