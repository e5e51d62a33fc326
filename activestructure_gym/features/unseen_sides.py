"""Compute the area of surfaces whose visible side no keyframe has seen."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.compiling.thread_team import TEAM, default_threads
from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.hole_area import REACH, solid_angles, taken_before
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.mapping.density import bucket
from activestructure_gym.mapping.map_passes import faces_away
from activestructure_gym.splatting.counters import take_ticket

NEAR = 0.06  # metres, radius around a surface point in which its disks are searched; they are at most 4.5 cm apart
_STRIDE = 2  # pixels from one tested pixel to the next, in both directions
_SOLID = 0.5  # alpha above which a pixel has a depth


@FEATURES.register("unseen_sides", unit="m^2", low=0.0)
def unseen_sides(context: FeatureContext) -> np.ndarray:  # [K]
    """Return the area, perpendicular to the rays, of the pixels that show the back of a mapped surface.

    It is the sum of alpha x solid angle x min(d, 4 m)^2, where d is the distance of the rendered surface. The normal of
    a disk-shaped Gaussian points towards the camera that created it. A pixel shows a back if there are disks within
    6 cm of its rendered surface point, and all of them face away from the view. No keyframe has seen this surface from
    that side: it is the far side of a thin object, or the inside of an object seen from outside. The map is opaque
    there, so `hole_area` finds no hole. A view close to a keyframe pose counts 0. Isotropic Gaussians have no back.

    The feature is our own; [gavis] also distinguishes the sides of a cell. Its measured effect is in
    docs/notebook/lab_notes.md.
    """
    camera = context.camera
    alpha, depth = context.alpha[:, ::_STRIDE, ::_STRIDE], context.depth[:, ::_STRIDE, ::_STRIDE]
    rays = camera.rays()[::_STRIDE, ::_STRIDE].astype(np.float64)
    along = np.where(alpha > _SOLID, depth / np.maximum(alpha, 1e-6), 0.0).astype(np.float32)
    backs = shown_from_behind(context, rays, along)
    distance = along * np.linalg.norm(rays, axis=-1)
    angle = solid_angles(camera)[::_STRIDE, ::_STRIDE] * _STRIDE**2
    area = (backs * alpha * angle * np.minimum(distance, REACH) ** 2).sum(axis=(1, 2))
    keyframes = np.array([frame.world_from_camera for frame in context.mapper.keyframes]).reshape(-1, 4, 4)
    return np.asarray(area * np.logical_not(taken_before(context.world_from_camera, keyframes)))


def shown_from_behind(
    context: FeatureContext,
    rays: np.ndarray,  # [h, w, 3] camera frame, depth 1
    depth: np.ndarray,  # [K, h, w] float32 metres; 0 = not tested
) -> np.ndarray:  # [K, h, w] bool
    """Return which pixels have disks around their surface point that all face away from the camera."""
    gaussians = context.mapper.map
    heads, following = _sorted_into_cells(gaussians.parameters, gaussians.count, NEAR)
    table = _Table(gaussians.parameters, heads, following, NEAR)
    poses = np.ascontiguousarray(context.world_from_camera, dtype=np.float64)
    backs = np.zeros(depth.shape, dtype=bool)
    threads = max(1, min(default_threads(), len(poses)))
    TEAM.run(_find_backs, (np.zeros(2, np.int64), table, poses, rays, np.ascontiguousarray(depth), backs), threads)
    return backs


class _Table(NamedTuple):
    """Hold a hash table of the opaque Gaussians by the grid cell of their mean."""

    parameters: np.ndarray  # [14, capacity] float32
    heads: np.ndarray  # [buckets] int32, first Gaussian of the bucket's list; -1 = empty
    following: np.ndarray  # [count] int32, next Gaussian of the list; -1 = end
    cell: float  # metres, side length of a cell


@kernel
def _sorted_into_cells(parameters, count, cell):  # type: ignore[no-untyped-def]
    """Return ``heads`` and ``following`` of a `_Table` for cells of side ``cell`` in metres."""
    size = 16
    while size < 2 * count:
        size *= 2
    heads, following = np.full(size, -1, np.int32), np.empty(count, np.int32)
    for i in range(count):
        if parameters[10, i] < 0.0:  # opacity below 0.5
            continue
        place = bucket(
            int(np.floor(parameters[0, i] / cell)),
            int(np.floor(parameters[1, i] / cell)),
            int(np.floor(parameters[2, i] / cell)),
            size,
        )
        following[i], heads[place] = heads[place], i
    return heads, following


@kernel
def _sides_in(table, a, b, c, point, eye):  # type: ignore[no-untyped-def]
    """Return whether cell (a, b, c) has disks near a point that face away from ``eye``, and whether one faces it.

    The search ends at the first disk that faces it.
    """
    parameters, heads, following, cell = table
    back = False
    i = heads[bucket(a, b, c, len(heads))]
    while i >= 0:
        dx, dy, dz = parameters[0, i] - point[0], parameters[1, i] - point[1], parameters[2, i] - point[2]
        if dx * dx + dy * dy + dz * dz <= cell * cell:
            if not faces_away(parameters, i, eye[0], eye[1], eye[2]):
                return back, True
            back = True
        i = following[i]
    return back, False


@kernel
def _find_backs(tickets, table, poses, rays, depth, backs):  # type: ignore[no-untyped-def]
    """Set ``backs`` [K, h, w] where all opaque Gaussians near a pixel's surface point face away; one view per ticket.

    The arguments are those of `shown_from_behind`; a ticket is a view that a thread has taken from the common counter.
    """
    cell = table.cell
    while True:
        k: int = take_ticket(tickets, 0)  # type: ignore[call-arg]
        if k >= len(poses):
            return
        pose = poses[k]
        eye_x, eye_y, eye_z = np.float32(pose[0, 3]), np.float32(pose[1, 3]), np.float32(pose[2, 3])
        for row in range(rays.shape[0]):
            for column in range(rays.shape[1]):
                z = depth[k, row, column]
                if not z > 0.0:
                    continue
                ray = rays[row, column]
                x = pose[0, 3] + z * (pose[0, 0] * ray[0] + pose[0, 1] * ray[1] + pose[0, 2] * ray[2])
                y = pose[1, 3] + z * (pose[1, 0] * ray[0] + pose[1, 1] * ray[1] + pose[1, 2] * ray[2])
                w = pose[2, 3] + z * (pose[2, 0] * ray[0] + pose[2, 1] * ray[1] + pose[2, 2] * ray[2])
                a_0, a_1 = int(np.floor((x - cell) / cell)), int(np.floor((x + cell) / cell))
                b_0, b_1 = int(np.floor((y - cell) / cell)), int(np.floor((y + cell) / cell))
                c_0, c_1 = int(np.floor((w - cell) / cell)), int(np.floor((w + cell) / cell))
                # Most points have a disk that faces the camera in their own cell, where the search ends.
                point, eye = (x, y, w), (eye_x, eye_y, eye_z)
                back, front = _sides_in(table, (a_0 + a_1) // 2, (b_0 + b_1) // 2, (c_0 + c_1) // 2, point, eye)
                for a in range(a_0, a_1 + 1):
                    for b in range(b_0, b_1 + 1):
                        for c in range(c_0, c_1 + 1):
                            if not front:
                                behind, front = _sides_in(table, a, b, c, point, eye)
                                back = back or behind
                backs[k, row, column] = back and not front
