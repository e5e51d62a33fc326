"""Compute ANM-S's features: clusters of uncertain surface at a Voronoi node, and the ends of its cut branches.

A cut branch leads from a node of the Voronoi graph to an end without a junction; `planar_graph` removes it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.uncertain_surface import (
    Clusters,
    Surface,
    by_perturbing_means,
    by_proxy,
    clusters,
)
from activestructure_gym.features.voronoi_node import floor_graph, voronoi_node

KEPT = 0.2  # share of the surface that is clustered, the most uncertain part
SAME_VIEW = float(np.cos(np.radians(45.0)))  # cosine; one view serves all directions within 45 degrees of it


_COLUMNS: dict[str, Any] = {
    "columns": ("clusters", "looks", "facing"),
    "unit": ("clusters", "views", "cosine"),
    "low": (0.0, 0.0, -1.0),
    "high": (np.inf, np.inf, 1.0),
}


@FEATURES.register("anm_s", **_COLUMNS)
def anm_s(context: FeatureContext) -> np.ndarray:  # [K, 3]
    """Compute, at the candidate's Voronoi node, the numbers of uncertain clusters and of views of them, and a cosine.

    A cluster is a connected part of the most uncertain 20 % of the surface. The first column counts the clusters whose
    nearest node is the candidate's. The second is the number of views that see these clusters and the ends of the cut
    branches of the node. The third is the cosine between the candidate's view direction and the nearest direction to
    one of them. The uncertainty comes from 20 renderings of the map with perturbed means. Source: [anm_s, code].
    """
    return views_at_node(context, by_perturbing_means)


@FEATURES.register("anm_s_proxy", **_COLUMNS)
def anm_s_proxy(context: FeatureContext) -> np.ndarray:  # [K, 3]
    """Compute, at the candidate's Voronoi node, the numbers of uncertain clusters and of views of them, and a cosine.

    The columns are those of ``anm_s``, which explains them. The uncertainty is a first-order approximation that needs
    no rendering.
    """
    return views_at_node(context, by_proxy)


def views_at_node(
    context: FeatureContext, uncertainty: Callable[[FeatureContext], Surface]
) -> np.ndarray:  # [K, 3] clusters, views, cosine
    """Compute the clusters at the candidate's node, the views they need, and the candidate's alignment ([anm_s]).

    ``uncertainty`` returns the surface with its uncertainty. The columns are 0, 0, -1 without a node. Otherwise they
    are:

    - Number of clusters for which the candidate's node of `floor_graph` is the nearest one in the horizontal plane.
    - Number of views needed to see these clusters and the ends of the cut branches of the node.
    - Cosine between the candidate's view direction and the nearest direction to one of these; -1 if there is none.
    """
    found = clusters(context.once(uncertainty), KEPT)
    graph = context.once(floor_graph)
    node, poses = context.once(voronoi_node).astype(np.int64), context.world_from_camera
    anchors = anchored(found, graph.nodes)
    table = np.tile([0.0, 0.0, -1.0], (len(poses), 1))
    for n in np.unique(node[node >= 0]):
        centres, ends = found.centres[anchors == n], graph.chain_ends[graph.chain_nodes == n]
        for row in np.flatnonzero(node == n):
            here = poses[row, :3, 3]
            level = np.concatenate([ends, np.full((len(ends), 1), here[2])], axis=1)
            offsets = np.concatenate([centres, level]) - here
            lengths = np.linalg.norm(offsets, axis=1, keepdims=True)
            directions = (offsets / np.maximum(lengths, 1e-9))[lengths[:, 0] > 1e-6]  # none at the candidate itself
            table[row] = len(centres), count_views(directions), (directions @ poses[row, :3, 2]).max(initial=-1.0)
    return table


def anchored(found: Clusters, nodes: np.ndarray) -> np.ndarray:  # [C] int64 nodes; -1 without any node
    """Return the index of the node nearest to each cluster's target; ``nodes`` [N, 2] are metres in the floor plane."""
    if not len(nodes):
        return np.full(len(found.targets), -1)
    return np.linalg.norm(found.targets[:, None, :2] - nodes, axis=2).argmin(axis=1)


def count_views(directions: np.ndarray) -> int:  # [L, 3] unit
    """Return the number of views that serve all directions; a view serves directions within 45 degrees of its own.

    The views are placed in order: each is towards the first direction that no earlier view serves.
    """
    count = 0
    while len(directions):
        directions, count = directions[directions @ directions[0] < SAME_VIEW], count + 1
    return count
