"""Thin point sets to one point per voxel, and match reconstructed with true points as ActiveGAMER does."""

from __future__ import annotations

import numpy as np

from activestructure_gym.evaluation.metrics.nearest import PointTree


def nearest_per_voxel(
    points: np.ndarray,  # [N, 3] metres
    size: float,  # metres
) -> tuple[np.ndarray, np.ndarray]:  # [K] indices into points, [K, 3] centres of their voxels
    """Return for each occupied voxel the point that is nearest to its centre; of equally near points the first.

    The voxels are cubes of side ``size``, aligned with the origin of the coordinates.
    """
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
    points: np.ndarray,  # [P, 3] metres: thinned points of the reconstruction
    true: np.ndarray,  # [G, 3] metres: thinned points of the true surface
    centres: np.ndarray,  # [G, 3] metres: voxel centres of the true points
) -> tuple[np.ndarray, np.ndarray]:  # [G], [G] metres
    """Return the distance from each match to the nearest true point, and from each true point to the nearest match.

    The match of a true point is the reconstructed point nearest to its voxel centre. A reconstructed point can be the
    match of several true points, or of none. So a floater (a point far from the true surface) counts only
    where no other point is nearer to a true voxel.
    """
    if not len(points) or not len(true):
        return np.full(len(true), np.inf), np.full(len(true), np.inf)
    match = PointTree(points).query(centres)[1]
    used, back = np.unique(match, return_inverse=True)
    to_true = PointTree(true).query(points[used])[0][back]
    return to_true, PointTree(points[used]).query(true)[0]
