"""Which planes of the Plane Scene Graph a candidate view would see (V_c^vis of Sec. 3.4)."""

from __future__ import annotations

import numpy as np

from activestructure_gym.geometry import PinholeCamera, invert_rigid

NEAREST_M = 0.2  # closer than this a depth sensor returns nothing (method.md 5)
FARTHEST_M = 5.0  # distance gate (method.md 5)
STEEPEST_COSINE = float(np.cos(np.radians(80.0)))  # view-angle filter (method.md 5)
LEAST_SHARE = 0.1  # of a plane's points that must pass for the plane to count as visible


def visible_planes(
    points: np.ndarray,  # [P, S, 3] sample points of every plane, world
    normals: np.ndarray,  # [P, 3] unit
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [K, 4, 4]
) -> np.ndarray:  # [K, P] bool
    """Frustum culling, distance gating and view-angle filtering, as the paper has it; occlusion is not tested."""
    if not len(points) or not len(world_from_camera):
        return np.zeros((len(world_from_camera), len(points)), dtype=bool)
    camera_from_world = invert_rigid(world_from_camera)
    # [K, P, S, 3]
    local = np.einsum("kij,psj->kpsi", camera_from_world[:, :3, :3], points) + camera_from_world[:, None, None, :3, 3]
    z = local[..., 2]
    distance = np.linalg.norm(local, axis=-1)
    in_range = (z > 0) & (distance >= NEAREST_M) & (distance <= FARTHEST_M)
    pixels = camera.project(np.where(in_range[..., None], local, 1.0))
    inside = (pixels >= 0).all(-1) & (pixels[..., 0] < camera.width) & (pixels[..., 1] < camera.height)
    towards = points[None] - world_from_camera[:, None, None, :3, 3]  # [K, P, S, 3]
    cosine = np.abs(np.einsum("kpsi,pi->kps", towards, normals)) / np.maximum(distance, 1e-9)
    return (in_range & inside & (cosine >= STEEPEST_COSINE)).mean(axis=2) >= LEAST_SHARE
