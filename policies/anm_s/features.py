"""ANM-S's features: uncertain clusters at a Voronoi node, and the ends of the chains that were cut off from it."""

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

KEPT = 0.2  # of the surface, the most uncertain
ONE_LOOK = float(np.cos(np.radians(45.0)))  # directions nearer to each other than this take one look


_COLUMNS: dict[str, Any] = {
    "columns": ("clusters", "looks", "facing"),
    "unit": ("clusters", "views", "cosine"),
    "low": (0.0, 0.0, -1.0),
    "high": (np.inf, np.inf, 1.0),
}


@FEATURES.register("anm_s", **_COLUMNS)
def anm_s(context: FeatureContext) -> np.ndarray:  # [K, 3]
    """`looks` with the uncertainty of ANM-S: 20 renderings of perturbed geometry."""
    return looks(context, by_perturbing_means)


@FEATURES.register("anm_s_proxy", **_COLUMNS)
def anm_s_proxy(context: FeatureContext) -> np.ndarray:  # [K, 3]
    """`looks` with the first order of that uncertainty, which needs no rendering."""
    return looks(context, by_proxy)


def looks(context: FeatureContext, uncertainty: Callable[[FeatureContext], Surface]) -> np.ndarray:  # [K, 3]
    """Clusters at the candidate's node, looks they take, and the cosine to the nearest; 0, 0, -1 without a node.

    Clusters that the node is the nearest one to, as seen from above ([anm_s]); how many looks it takes to see
    these and the ends of the chains that hung from it; and the cosine between where the candidate looks and the nearest
    of all of these, -1 without any. Nodes are those of `floor_graph`.
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
            ways = np.concatenate([centres, level]) - here
            lengths = np.linalg.norm(ways, axis=1, keepdims=True)
            ways = (ways / np.maximum(lengths, 1e-9))[lengths[:, 0] > 1e-6]  # what is here needs no look
            table[row] = len(centres), count_looks(ways), (ways @ poses[row, :3, 2]).max(initial=-1.0)
    return table


def anchored(found: Clusters, nodes: np.ndarray) -> np.ndarray:  # [C] int64 nodes; -1 without any node
    """The node nearest to each cluster's target, seen from above."""
    if not len(nodes):
        return np.full(len(found.targets), -1)
    return np.linalg.norm(found.targets[:, None, :2] - nodes, axis=2).argmin(axis=1)


def count_looks(ways: np.ndarray) -> int:  # [L, 3] unit
    """Number of looks that see all these directions, each towards the first direction not seen yet."""
    count = 0
    while len(ways):
        ways, count = ways[ways @ ways[0] < ONE_LOOK], count + 1
    return count
