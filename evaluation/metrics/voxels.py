"""ActiveGAMER's way from two point sets to two sets of equal size: both thinned to voxels, and matched."""

from __future__ import annotations

import numpy as np

from activestructure_gym.evaluation.metrics.nearest import PointTree


def nearest_per_voxel(
    points: np.ndarray,  # [N, 3] metres
    size: float,  # metres
) -> tuple[np.ndarray, np.ndarray]:  # [K] indices into points, [K, 3] centres of their voxels
    """Per occupied voxel of the grid through the origin the point nearest to its centre (the first of equals)."""
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    if not len(points):
        return np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    voxel = np.floor(points / size).astype(np.int64)
    centre = (voxel + 0.5) * size
    voxel -= voxel.min(axis=0)
    extent = voxel.max(axis=0) + 1
    key = (voxel[:, 0] * extent[1] + voxel[:, 1]) * extent[2] + voxel[:, 2]
    order = np.lexsort((((points - centre) ** 2).sum(axis=1), key))
    first = np.ones(len(order), dtype=bool)
    first[1:] = np.diff(key[order]) > 0
    chosen = order[first]
    return chosen, centre[chosen]


def matched_distances(
    points: np.ndarray,  # [P, 3] metres: the reconstruction, thinned
    true: np.ndarray,  # [G, 3] metres: the truth, thinned
    centres: np.ndarray,  # [G, 3] metres: the voxel centres of the truth
) -> tuple[np.ndarray, np.ndarray]:  # [G], [G] metres
    """Distances of the matched reconstruction to the truth and of the truth to it.

    The matched reconstruction holds, for every true point, the point nearest to that one's voxel centre: as many
    points as the truth has, some of them often, and none that is nobody's nearest. So no floater is in it.
    """
    if not len(points) or not len(true):
        return np.full(len(true), np.inf), np.full(len(true), np.inf)
    match = PointTree(points).query(centres)[1]
    used, back = np.unique(match, return_inverse=True)
    to_true = PointTree(true).query(points[used])[0][back]
    return to_true, PointTree(points[used]).query(true)[0]
