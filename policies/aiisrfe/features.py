"""Compute the feature of Zeng et al.: the frontier that a view serves, and the colour uncertainty that it sees."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from activestructure_gym.features.blending import blended
from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.unexplored import sums_in_front, surface_within
from activestructure_gym.features.unknown_volume import target_voxels
from activestructure_gym.features.voxel_errors import voxel_colour_errors
from activestructure_gym.volume import FREE

CLUSTER = 2.0  # metres, side of the cubes into which frontiers are cut (own choice)
MIN_FRONTIER_VOXELS = 50  # minimum number of voxels of a frontier, as in the code
MIN_VISIBLE_VOXELS = 15  # a frontier is ignored unless a view sees more of its voxels, as in the code


@FEATURES.register(
    "aiisrfe",
    columns=("frontier", "uncertainty"),
    unit=("index", "mean squared colour error"),
    low=(-1.0, 0.0),
)
def aiisrfe(context: FeatureContext) -> np.ndarray:  # [K, 2]
    """Compute the frontier that a candidate serves, and the mean colour uncertainty that it sees.

    The columns are:

    - the index of the frontier, or -1;
    - the mean over pixels of the uncertainty (mean squared colour error) of the visible surface.

    A frontier is a connected cluster of free voxels next to space that no keyframe has seen. The candidate that sees
    most voxels of a frontier serves it; a frontier of which none sees more than 15 is ignored. The uncertainty of a
    place is the mean squared error of its rendered colours. The learned variance of colour in the original converges to
    this error. Source: [aiisrfe], by its abstract and a summary.
    """
    poses = context.world_from_camera
    table = np.zeros((len(poses), 2))
    table[:, 0] = -1.0
    voxels, cluster = frontiers(context)
    clusters = int(cluster.max(initial=-1)) + 1
    if len(poses) and clusters:
        surface = surface_within(context, context.coverage_alpha)
        counts = sums_in_front(voxels, np.ones(len(voxels)), surface, context, cluster)
        counts[context.revisits] = 0  # revisits serve no frontier
        served = np.flatnonzero(counts.max(axis=0) > MIN_VISIBLE_VOXELS)
        for c in served[::-1]:  # a candidate that would serve two frontiers gets the first
            table[counts[:, c].argmax(), 0] = c
    if len(poses):
        unsure = voxel_colour_errors(context.mapper, context.volume)
        table[:, 1] = blended(context, _of_gaussians(context, unsure)).mean(axis=(1, 2))
    return table


def frontiers(context: FeatureContext) -> tuple[np.ndarray, np.ndarray]:  # [F, 3] metres, [F] cluster
    """Return the centres of the F frontier voxels, and the index of the cluster of each.

    A cluster is the part of a connected frontier (26 neighbours) in a cube of 2 m, with at least 50 voxels.
    """
    volume = context.volume
    wanted = context.once(target_voxels)
    edge = (volume.state == FREE) & ndimage.binary_dilation(wanted, np.ones((3, 3, 3), bool))
    labels, _ = ndimage.label(edge, np.ones((3, 3, 3), bool))
    voxels = np.argwhere(edge)
    centres = volume.center_of(voxels)
    cubes = np.floor((centres - volume.origin) / CLUSTER).astype(np.int64)
    parts = np.column_stack([labels[tuple(voxels.T)], cubes])
    _, cluster, sizes = np.unique(parts, axis=0, return_inverse=True, return_counts=True)
    cluster = cluster.ravel()
    kept = sizes[cluster] >= MIN_FRONTIER_VOXELS
    return centres[kept], np.unique(cluster[kept], return_inverse=True)[1].ravel()


def _of_gaussians(context: FeatureContext, table: np.ndarray) -> np.ndarray:  # [X, Y, Z] -> [N] float32
    """Return, for each Gaussian, the value of ``table`` at the voxel of its mean; 0 outside the volume."""
    means, volume = context.mapper.map.means, context.volume
    values = np.zeros(len(means), np.float32)
    inside = volume.contains(means)
    values[inside] = table[tuple(volume.voxel_of(means[inside]).T)]
    return values
