"""What the mode-switching planner of Zeng et al. asks: which frontier a view serves, and how unsure its surface is."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from activestructure_gym.features.blending import blended
from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.unexplored import sums_in_front, surface_within
from activestructure_gym.features.unknown_volume import worth_a_look
from activestructure_gym.features.voxel_errors import voxel_colour_errors
from activestructure_gym.volume import FREE

CLUSTER = 2.0  # metres, side of the cubes that large frontiers are cut into (own choice)
MIN_FRONTIER_VOXELS = 5  # voxels of a frontier (own choice)
NEAR = 3.0  # metres from the agent (own choice)


@FEATURES.register(
    "aiisrfe",
    columns=("frontier", "near", "total", "uncertainty"),
    unit=("index", "clusters", "clusters", "mean squared colour error"),
    low=(-1.0, 0.0, 0.0, 0.0),
)
def aiisrfe(context: FeatureContext) -> np.ndarray:  # [K, 4]
    """Which frontier a view is the one for, or -1; how many frontiers are near the agent, and in all; and the mean over
    pixels of the colour uncertainty of the surface in sight.

    A frontier is a connected cluster of free voxels beside space that nobody has looked into. The view for it is the
    candidate that has most of its voxels in sight; one that nobody has in sight is none. Near are those whose middle is
    within 3 m of the agent. The uncertainty of a place is the mean squared error of the rendered colour there, what the
    variance of a learned colour tends to. Source: [aiisrfe], by abstract and digest.
    """
    poses, keyframes = context.world_from_camera, context.mapper.keyframes
    table = np.zeros((len(poses), 4))
    table[:, 0] = -1.0
    voxels, cluster = frontiers(context)
    clusters = int(cluster.max(initial=-1)) + 1
    if len(poses) and clusters:
        counts = sums_in_front(voxels, np.ones(len(voxels)), surface_within(context), context, cluster)
        counts[context.revisits] = 0  # nobody is sent there for what it shows
        served = counts.max(axis=0) > 0
        middles = np.stack([voxels[cluster == c].mean(axis=0) for c in range(clusters)])
        here = keyframes[-1].world_from_camera[:3, 3] if context.agent is None else context.agent.pose[:3, 3]
        near = np.linalg.norm(middles - here, axis=1) <= NEAR
        for c in np.flatnonzero(served)[::-1]:  # a view for two frontiers is the first one's
            table[counts[:, c].argmax(), 0] = c
        table[:, 1], table[:, 2] = (near & served).sum(), served.sum()
    if len(poses):
        unsure = voxel_colour_errors(context.mapper, context.volume)
        table[:, 3] = blended(context, _of_gaussians(context, unsure)).mean(axis=(1, 2))
    return table


def frontiers(context: FeatureContext) -> tuple[np.ndarray, np.ndarray]:  # [F, 3] metres, [F] cluster
    """Frontier voxels, and the clusters 0, 1, ... that they belong to, cut into cubes."""
    volume = context.volume
    wanted = context.once(worth_a_look)
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
    """What stands in the voxel of each Gaussian's mean."""
    means, volume = context.mapper.map.means, context.volume
    values = np.zeros(len(means), np.float32)
    inside = volume.contains(means)
    values[inside] = table[tuple(volume.voxel_of(means[inside]).T)]
    return values
