"""Which node of the floor plan's Voronoi graph a view stands for."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.motion import VoronoiGraph, planar_graph

NODE_REACH = 0.5  # metres in the plane: views farther from every node stand for none; a step of the view lattice


@FEATURES.register("voronoi_node", unit="index", low=-1.0)
def voronoi_node(context: FeatureContext) -> np.ndarray:  # [K] whole numbers
    """Index of the nearest node of `floor_graph`, -1 beyond `NODE_REACH`. Indices are of this step only."""
    positions, nodes = context.world_from_camera[:, :2, 3], context.once(floor_graph).nodes
    if not len(nodes):
        return np.full(len(positions), -1.0)
    distance = np.linalg.norm(positions[:, None] - nodes, axis=2)
    return np.where(distance.min(axis=1) <= NODE_REACH, distance.argmin(axis=1), -1)


def floor_graph(context: FeatureContext) -> VoronoiGraph:
    """The Voronoi graph at the height where the agent started; share it by ``context.once(floor_graph)``."""
    return planar_graph(context.volume, context.mapper.keyframes[0].world_from_camera[:3, 3])


def places(context: FeatureContext) -> np.ndarray:  # [K, 3] metres
    """Position of every view's node, or of the view itself where it has none; at the view's height."""
    positions = context.world_from_camera[:, :3, 3].copy()
    node = context.once(voronoi_node).astype(np.int64)
    positions[node >= 0, :2] = context.once(floor_graph).nodes[node[node >= 0]]
    return positions
