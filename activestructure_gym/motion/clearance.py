"""Check the clearance of paths; a start that is too close to an obstacle is allowed to leave it."""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.volume import VoxelVolume
from activestructure_gym.volume.distance_field import sample

# Metres: length of the first part of a path in which clearance may be too small, after a start with too little.
ESCAPE_REACH = 0.5
# Metres: clearance in that part may be this much below the clearance of the start, but never below this value.
TOUCHING = 1e-3
# Largest distance between two samples of an edge, in voxels.
_SAMPLING = 0.5
# Voxels: largest decrease of the interpolated clearance between two samples, as its slope is at most sqrt(3).
SAMPLING_DIP = 0.25 * np.sqrt(3.0)


def first_blocked_edge(
    volume: VoxelVolume,
    path: np.ndarray,  # [P, 3] metres, world
    *,
    min_clearance: float,  # metres
) -> int | None:
    """Return the index of the first edge of the path with a clearance below ``min_clearance``; None if there is none.

    If the start itself has less clearance, the path may have the clearance of the start within its first 0.5 m, until
    it first reaches ``min_clearance``. So an agent next to a newly observed obstacle can leave. Edges of zero length
    (turning in place) are never blocked.
    """
    points = np.ascontiguousarray((np.asarray(path, dtype=np.float64) - volume.origin) / volume.voxel_size - 0.5)
    if len(points) < 2:
        return None
    field = volume.clearance_around(points, enough=min_clearance)
    edge = _first_blocked_edge(field, points, min_clearance, ESCAPE_REACH / volume.voxel_size)
    return None if edge < 0 else int(edge)


@kernel
def _first_blocked_edge(
    field: np.ndarray,  # [X, Y, Z] clearance, metres
    points: np.ndarray,  # [P, 3] voxels
    bound: float,  # least clearance, metres
    reach: float,  # length of the exception at the start, voxels
) -> int:
    own = sample(field, points[0, 0], points[0, 1], points[0, 2])
    escaping = own < bound
    weaker = max(min(own, bound) - TOUCHING, TOUCHING)
    travelled = 0.0
    for n in range(len(points) - 1):
        offset = points[n + 1] - points[n]
        length = np.sqrt((offset * offset).sum())
        if length == 0.0:
            continue
        count = max(1, int(np.ceil(length / _SAMPLING)))
        for s in range(1, count + 1):
            p = points[n] + offset * (s / count)
            value = sample(field, p[0], p[1], p[2])
            if value >= bound:
                escaping = False
            elif not escaping or value < weaker or travelled + length * s / count > reach + 1e-6:
                return n
        travelled += length
    return -1
