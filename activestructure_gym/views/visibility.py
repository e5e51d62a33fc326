"""Compute which planes of the Plane Scene Graph a candidate view would see (V_c^vis of Sec. 3.4)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.compiling.thread_team import TEAM, default_threads
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.planes import PlaneNode
from activestructure_gym.splatting.counters import take_ticket
from activestructure_gym.volume import VoxelVolume
from activestructure_gym.volume.distance_field import SPARED, sight_line

MIN_DISTANCE_M = 0.2  # metres; at smaller distances a depth sensor returns nothing
MAX_DISTANCE_M = 5.0  # metres; the paper's distance gate (Sec. 3.4), which has no number in the paper: own choice
MIN_COSINE = float(np.cos(np.radians(80.0)))  # the paper's view-angle filter; 80 degrees are our choice
MIN_SHARE = 0.1  # fraction of a plane's sample points that must be visible for the plane to count as visible
_WORTH_A_THREAD = 2000  # number of view-plane pairs below which one thread computes faster than several
SAMPLES = 16  # sample points per plane, spread evenly over its stored points


def visible_planes(
    planes: Sequence[PlaneNode],  # P planes
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [K, 4, 4] poses of the K candidates
    volume: VoxelVolume | None = None,  # voxel map for occlusion; None ignores occlusion
) -> np.ndarray:  # [K, P] bool: plane p is visible from candidate k
    """Return which planes are visible, by frustum culling, distance gating and view-angle filtering as in the paper.

    A plane is visible only from its front side. With a ``volume``, points behind an occupied voxel count as hidden,
    which the paper does not require.
    """
    if not len(planes) or not len(world_from_camera):
        return np.zeros((len(world_from_camera), len(planes)), dtype=bool)
    points = np.array([plane.spread(SAMPLES) for plane in planes])  # [P, S, 3]
    normals = np.array([plane.normal for plane in planes])  # [P, 3]
    enough = int(np.ceil(MIN_SHARE * SAMPLES))
    return visible_cosines(points, normals, camera, world_from_camera, volume, enough=enough)[1] == enough


def visible_cosines(
    points: np.ndarray,  # [P, S, 3] metres, world: S sample points of each of P planes
    normals: np.ndarray,  # [P, 3] unit normals of the planes
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [K, 4, 4] poses of K views
    volume: VoxelVolume | None = None,  # voxel map for occlusion; None ignores occlusion
    *,
    farthest: np.ndarray | float = np.inf,  # [P] metres: points of a plane at a larger depth count as hidden
    enough: int = 1 << 30,  # stop testing a plane after this number of visible points
) -> tuple[np.ndarray, np.ndarray]:  # [K, P, S] float64, [K, P] int64
    """Return the cosine between normal and line of sight per sample point, and the number of visible points per plane.

    Both are given for each view. The cosine is 0 for hidden points: outside the frustum, the distance gate or the view
    angle, or behind an occupied voxel. The points of a plane are tested until ``enough`` are visible, or can no longer
    be.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    poses = np.ascontiguousarray(world_from_camera, dtype=np.float64)
    if volume is None:
        blocking, eyes, ends = np.zeros((0, 0, 0), dtype=bool), poses[:, :3, 3].copy(), points
    else:
        blocking, eyes, ends = volume.occupied, volume.in_voxels(poses[:, :3, 3]), volume.in_voxels(points)
    shape = (len(poses), len(points), points.shape[1])
    cosines, counts = np.zeros(shape), np.zeros(shape[:2], np.int64)
    targets = _Targets(
        points,
        np.ascontiguousarray(normals, dtype=np.float64),
        ends,
        np.full(len(points), farthest, dtype=np.float64),
        min(enough, points.shape[1] + 1),
    )
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height], dtype=np.float64)
    arguments = (np.zeros(1, np.int64), targets, poses, eyes, lens, blocking, cosines, counts)
    TEAM.run(_visible_cosines, arguments, default_threads() if counts.size >= _WORTH_A_THREAD else 1)
    return cosines, counts


class _Targets(NamedTuple):
    """Hold the sample points of the planes and the parameters of their visibility test, as one kernel argument."""

    points: np.ndarray  # [P, S, 3] metres, world
    normals: np.ndarray  # [P, 3] unit
    ends: np.ndarray  # [P, S, 3] the same points in voxel coordinates
    farthest: np.ndarray  # [P] metres: largest depth of a visible point
    enough: int  # number of visible points after which a plane is not tested further


@kernel
def _visible_cosines(
    tickets: np.ndarray,  # [1] int64 counter of the views that threads have started
    targets: _Targets,
    poses: np.ndarray,  # [K, 4, 4] world_from_camera
    eyes: np.ndarray,  # [K, 3] camera positions in voxel coordinates
    lens: np.ndarray,  # [6] fx, fy, cx, cy, width, height
    blocking: np.ndarray,  # [X, Y, Z] bool: occupied voxels; empty to ignore occlusion
    cosines: np.ndarray,  # [K, P, S] output, zeros on entry
    counts: np.ndarray,  # [K, P] output, zeros on entry
) -> None:
    """Compute `visible_cosines`. Cheap tests come first; the line of sight through the voxels is tested last."""
    points, normals, ends, farthest, enough = targets
    samples = points.shape[1]
    while True:
        k: int = take_ticket(tickets, 0)  # type: ignore[call-arg]
        if k >= len(poses):
            return
        eye_x, eye_y, eye_z = poses[k, 0, 3], poses[k, 1, 3], poses[k, 2, 3]
        right_x, right_y, right_z = poses[k, 0, 0], poses[k, 1, 0], poses[k, 2, 0]
        down_x, down_y, down_z = poses[k, 0, 1], poses[k, 1, 1], poses[k, 2, 1]
        ahead_x, ahead_y, ahead_z = poses[k, 0, 2], poses[k, 1, 2], poses[k, 2, 2]
        for p in range(len(points)):
            found = 0
            for s in range(samples):
                if found == enough or (enough <= samples and found + samples - s < enough):
                    break
                x, y, z = points[p, s, 0] - eye_x, points[p, s, 1] - eye_y, points[p, s, 2] - eye_z
                depth = ahead_x * x + ahead_y * y + ahead_z * z
                if depth <= 0.0 or depth > farthest[p]:
                    continue
                height = -(x * normals[p, 0] + y * normals[p, 1] + z * normals[p, 2])
                if height <= 0.0:  # the camera is behind the plane
                    continue
                distance = np.sqrt(x * x + y * y + z * z)
                if distance < MIN_DISTANCE_M or distance > MAX_DISTANCE_M:
                    continue
                cosine = height / distance
                if cosine < MIN_COSINE:
                    continue
                u = lens[0] * (right_x * x + right_y * y + right_z * z) / depth + lens[2]
                v = lens[1] * (down_x * x + down_y * y + down_z * z) / depth + lens[3]
                if not (0.0 <= u < lens[4] and 0.0 <= v < lens[5]):
                    continue
                i, j, m = ends[p, s, 0], ends[p, s, 1], ends[p, s, 2]
                if sight_line(blocking, eyes[k, 0], eyes[k, 1], eyes[k, 2], i, j, m, SPARED):
                    cosines[k, p, s] = cosine
                    found += 1
            counts[k, p] = found
