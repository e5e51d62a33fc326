"""Assign each view to a node of the floor plan's Voronoi graph."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.motion import VoronoiGraph, planar_graph

NODE_REACH = 0.5  # metres, largest horizontal distance from a view to its node; equals one step of the view lattice


@FEATURES.register("voronoi_node", unit="index", low=-1.0)
def voronoi_node(context: FeatureContext) -> np.ndarray:  # [K] integers
    """Return the index of the Voronoi node nearest to each view, in `floor_graph`; -1 if it is farther than 0.5 m.

    The graph is computed anew in every step, so an index is valid in this step only.
    """
    positions, nodes = context.world_from_camera[:, :2, 3], context.once(floor_graph).nodes
    if not len(nodes):
        return np.full(len(positions), -1.0)
    distance = np.linalg.norm(positions[:, None] - nodes, axis=2)
    return np.where(distance.min(axis=1) <= NODE_REACH, distance.argmin(axis=1), -1)


def floor_graph(context: FeatureContext) -> VoronoiGraph:
    """Return the Voronoi graph of the free floor plan at the start height.

    Call ``context.once(floor_graph)``, which computes it once per step for all features.
    """
    return planar_graph(context.volume, context.mapper.keyframes[0].world_from_camera[:3, 3])


def places(context: FeatureContext) -> np.ndarray:  # [K, 3] metres
    """Return the position of each view's Voronoi node, at the height of the view; without a node, that of the view."""
    positions = context.world_from_camera[:, :3, 3].copy()
    node = context.once(voronoi_node).astype(np.int64)
    positions[node >= 0, :2] = context.once(floor_graph).nodes[node[node >= 0]]
    return positions
