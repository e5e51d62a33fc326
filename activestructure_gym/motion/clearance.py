"""Check the clearance of planned and executed path edges, with one exception for a start in a tight place."""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.volume import VoxelVolume
from activestructure_gym.volume.distance_field import sample

# Metres within which a start with too little clearance may move to a place with enough.
ESCAPE_REACH = 0.5
# Metres: clearance on that path may be this much below the start's own, but never below this value.
TOUCHING = 1e-3
# Distance between the samples of an edge, in voxels.
_SAMPLING = 0.5
# Voxels: largest dip of the interpolated field (slope at most sqrt 3) between two samples.
SAMPLING_DIP = 0.25 * np.sqrt(3.0)


def first_blocked_edge(
    volume: VoxelVolume,
    path: np.ndarray,  # [P, 3] metres, world
    *,
    min_clearance: float,  # metres
) -> int | None:
    """Return the index of the first edge of the path with too little clearance; None if there is none.

    A start closer to an obstacle is allowed: the path may have the start's clearance within its first 0.5 m, until it
    first reaches ``min_clearance``. An agent next to a newly observed obstacle can thus leave. Edges of zero length
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
    field: np.ndarray,
    points: np.ndarray,  # [P, 3] voxels
    bound: float,  # metres
    reach: float,  # voxels
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
