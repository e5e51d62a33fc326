"""Which planes of the Plane Scene Graph a candidate view would see (V_c^vis of Sec. 3.4)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.planes import PlaneNode
from activestructure_gym.splatting.caching import stamp_of
from activestructure_gym.volume import VoxelVolume, distance_field
from activestructure_gym.volume.distance_field import SPARED, sight_line

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
    enough = int(np.ceil(LEAST_SHARE * SAMPLES))
    return cosines_in_sight(points, normals, camera, world_from_camera, volume, enough=enough)[1] == enough


def cosines_in_sight(
    points: np.ndarray,  # [P, S, 3] metres, world
    normals: np.ndarray,  # [P, 3] unit, of all S points of a row
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [K, 4, 4]
    volume: VoxelVolume | None = None,  # without one nothing hides anything
    *,
    farthest: np.ndarray | float = np.inf,  # [P] metres of depth
    enough: int = 1 << 30,  # points of a row; those behind them are not looked at
) -> tuple[np.ndarray, np.ndarray]:  # [K, P, S] float64, [K, P] int64
    """Cosine between the normal and the line of sight, and how many points of every row have one.

    0 outside the frustum, the distance gate or the view angle, and behind an occupied voxel. A row that can no longer
    come to ``enough`` is left, too.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    poses = np.ascontiguousarray(world_from_camera, dtype=np.float64)
    if volume is None:
        blocking, eyes, ends = np.zeros((0, 0, 0), dtype=bool), poses[:, :3, 3].copy(), points
    else:
        blocking, eyes, ends = volume.occupied, volume.in_voxels(poses[:, :3, 3]), volume.in_voxels(points)
    return _cosines_in_sight(
        points,
        np.ascontiguousarray(normals, dtype=np.float64),
        poses,
        np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height], dtype=np.float64),
        np.full(len(points), farthest, dtype=np.float64),
        blocking,
        eyes,
        ends,
        min(enough, points.shape[1] + 1),
    )


@kernel
def _balls(points: np.ndarray, normals: np.ndarray) -> np.ndarray:  # [P, S, 3], [P, 3] -> [P, 5]
    """Centre and radius of a ball around every row's points, and how far they reach against the normal from there.

    Radius and reach are a micrometre longer.
    """
    balls = np.full((len(points), 5), 1e-6)
    samples = points.shape[1]
    for p in range(len(points)):
        for axis in range(3):
            balls[p, axis] = 0.0
            for s in range(samples):
                balls[p, axis] += points[p, s, axis] / samples
        for s in range(samples):
            x, y, z = points[p, s, 0] - balls[p, 0], points[p, s, 1] - balls[p, 1], points[p, s, 2] - balls[p, 2]
            balls[p, 3] = max(balls[p, 3], np.sqrt(x * x + y * y + z * z) + 1e-6)
            balls[p, 4] = max(balls[p, 4], 1e-6 - (x * normals[p, 0] + y * normals[p, 1] + z * normals[p, 2]))
    return balls


def _make_cosines_in_sight(stamp: int) -> Any:
    @kernel
    def cosines_in_sight(
        points: np.ndarray,  # [P, S, 3] metres, world
        normals: np.ndarray,  # [P, 3]
        poses: np.ndarray,  # [K, 4, 4] world_from_camera
        lens: np.ndarray,  # [6] fx, fy, cx, cy, width, height
        farthest: np.ndarray,  # [P] metres of depth
        blocking: np.ndarray,  # [X, Y, Z] bool
        eyes: np.ndarray,  # [K, 3] voxels
        ends: np.ndarray,  # [P, S, 3] voxels
        enough: int,
    ) -> tuple[np.ndarray, np.ndarray]:  # [K, P, S], [K, P]
        """Cheap tests first, the line of sight last; asked in every step of every candidate, hence compiled.

        The first test is for a ball around all points of a row. It refuses only where each point would be refused
        with a micrometre to spare, so it changes no answer.
        """
        _ = stamp
        samples = points.shape[1]
        balls = _balls(points, normals)
        # Distance of a point inside to the sides of the frustum, per metre of x (or y) and of depth.
        left, right = np.hypot(lens[0], lens[2]), np.hypot(lens[0], lens[4] - lens[2])
        upper, lower = np.hypot(lens[1], lens[3]), np.hypot(lens[1], lens[5] - lens[3])
        cosines = np.zeros((len(poses), len(points), samples))
        counts = np.zeros((len(poses), len(points)), np.int64)
        for k in range(len(poses)):
            eye_x, eye_y, eye_z = poses[k, 0, 3], poses[k, 1, 3], poses[k, 2, 3]
            right_x, right_y, right_z = poses[k, 0, 0], poses[k, 1, 0], poses[k, 2, 0]
            down_x, down_y, down_z = poses[k, 0, 1], poses[k, 1, 1], poses[k, 2, 1]
            ahead_x, ahead_y, ahead_z = poses[k, 0, 2], poses[k, 1, 2], poses[k, 2, 2]
            for p in range(len(points)):
                x, y, z = balls[p, 0] - eye_x, balls[p, 1] - eye_y, balls[p, 2] - eye_z
                radius = balls[p, 3]
                height = balls[p, 4] - (x * normals[p, 0] + y * normals[p, 1] + z * normals[p, 2])
                if height < STEEPEST_COSINE * NEAREST_M:
                    continue
                depth = ahead_x * x + ahead_y * y + ahead_z * z
                if depth < -radius or depth > farthest[p] + radius:
                    continue
                u = right_x * x + right_y * y + right_z * z
                v = down_x * x + down_y * y + down_z * z
                if (
                    lens[0] * u + lens[2] * depth < -radius * left
                    or (lens[4] - lens[2]) * depth - lens[0] * u < -radius * right
                    or lens[1] * v + lens[3] * depth < -radius * upper
                    or (lens[5] - lens[3]) * depth - lens[1] * v < -radius * lower
                ):
                    continue
                distance = np.sqrt(x * x + y * y + z * z)
                if distance > FARTHEST_M + radius or height < STEEPEST_COSINE * (distance - radius):
                    continue
                found = 0
                for s in range(samples):
                    if found == enough or (enough <= samples and found + samples - s < enough):
                        break
                    x, y, z = points[p, s, 0] - eye_x, points[p, s, 1] - eye_y, points[p, s, 2] - eye_z
                    depth = ahead_x * x + ahead_y * y + ahead_z * z
                    distance = np.sqrt(x * x + y * y + z * z)
                    if depth <= 0.0 or depth > farthest[p] or distance < NEAREST_M or distance > FARTHEST_M:
                        continue
                    u = lens[0] * (right_x * x + right_y * y + right_z * z) / depth + lens[2]
                    v = lens[1] * (down_x * x + down_y * y + down_z * z) / depth + lens[3]
                    if not (0.0 <= u < lens[4] and 0.0 <= v < lens[5]):
                        continue
                    cosine = -(x * normals[p, 0] + y * normals[p, 1] + z * normals[p, 2]) / distance
                    if cosine < STEEPEST_COSINE:
                        continue
                    i, j, m = ends[p, s, 0], ends[p, s, 1], ends[p, s, 2]
                    if sight_line(blocking, eyes[k, 0], eyes[k, 1], eyes[k, 2], i, j, m, SPARED):
                        cosines[k, p, s] = cosine
                        found += 1
                counts[k, p] = found
        return cosines, counts

    return cosines_in_sight


_cosines_in_sight = _make_cosines_in_sight(stamp_of(distance_field))


def _spread(points: np.ndarray) -> np.ndarray:  # [N, 3] -> [SAMPLES, 3]
    return points[np.arange(SAMPLES) * (len(points) - 1) // (SAMPLES - 1)]
