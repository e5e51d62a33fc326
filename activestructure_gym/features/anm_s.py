"""What ANM-S looks for at a Voronoi node: uncertain clusters, and the corners whose chains were cut off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from activestructure_gym.features.base import GAINS, GainContext
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


@dataclass(frozen=True)
class Looks:
    """What there is to look at from the candidates' nodes; all 0 for candidates without a node."""

    clusters: np.ndarray  # [K] clusters that the node is the nearest one to
    needed: np.ndarray  # [K] looks it takes to see these and the ends of the chains that hung from it
    facing: np.ndarray  # [K] cosine between where the candidate looks and the nearest of all of these; -1 without any


def column(context: GainContext, uncertainty: Callable[[GainContext], Surface], which: str) -> np.ndarray:  # [K]
    """Of the view's Voronoi node: its clusters, the looks it takes to see them, or how the view faces the nearest."""
    return getattr(context.once(_LOOKS[uncertainty]), which)


for _name, _kind in (("anm_s", by_perturbing_means), ("anm_s_proxy", by_proxy)):
    for _which, _column in (("clusters", "clusters"), ("looks", "needed"), ("facing", "facing")):
        GAINS.register(f"{_name}_{_which}")(partial(column, uncertainty=_kind, which=_column))


def looks(context: GainContext, uncertainty: Callable[[GainContext], Surface]) -> Looks:
    """Clusters belong to the nearest node of `floor_graph`, as seen from above ([anm_s])."""
    found = clusters(context.once(uncertainty), KEPT)
    graph = context.once(floor_graph)
    node, poses = context.once(voronoi_node).astype(np.int64), context.world_from_camera
    anchors = anchored(found, graph.nodes)
    result = Looks(np.zeros(len(poses)), np.zeros(len(poses)), np.full(len(poses), -1.0))
    for n in np.unique(node[node >= 0]):
        centres, ends = found.centres[anchors == n], graph.chain_ends[graph.chain_nodes == n]
        for row in np.flatnonzero(node == n):
            here = poses[row, :3, 3]
            level = np.concatenate([ends, np.full((len(ends), 1), here[2])], axis=1)
            ways = np.concatenate([centres, level]) - here
            ways /= np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-9)
            result.clusters[row], result.needed[row] = len(centres), count_looks(ways)
            result.facing[row] = (ways @ poses[row, :3, 2]).max(initial=-1.0)
    return result


_LOOKS: dict[Callable[[GainContext], Surface], Callable[[GainContext], Looks]] = {
    kind: partial(looks, uncertainty=kind) for kind in (by_perturbing_means, by_proxy)
}


def anchored(found: Clusters, nodes: np.ndarray) -> np.ndarray:  # [C] int64 nodes; -1 without any node
    """The node nearest to each cluster's target, seen from above."""
    if not len(nodes):
        return np.full(len(found.targets), -1)
    return np.linalg.norm(found.targets[:, None, :2] - nodes, axis=2).argmin(axis=1)


def count_looks(ways: np.ndarray) -> int:  # [L, 3] unit
    """How many looks see all these directions, each time in the first direction that is left."""
    count = 0
    while len(ways):
        ways, count = ways[ways @ ways[0] < ONE_LOOK], count + 1
    return count
