"""Assign each view to a node of the floor plan's Voronoi graph."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.motion import VoronoiGraph, free_plan, voronoi_graph

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


def floor_plan(context: FeatureContext) -> np.ndarray:  # [X, Y] bool
    """Return the voxels of the floor plan that are free for an agent at the start height (`free_plan`).

    Call ``context.once(floor_plan)``, which computes it once per step for all features.
    """
    return free_plan(context.volume, context.mapper.keyframes[0].world_from_camera[:3, 3])


def floor_graph(context: FeatureContext) -> VoronoiGraph:
    """Return the Voronoi graph of the `floor_plan`; call ``context.once(floor_graph)``."""
    return voronoi_graph(context.once(floor_plan), context.volume.origin[:2], context.volume.voxel_size)


def places(context: FeatureContext) -> np.ndarray:  # [K, 3] metres
    """Return the position of each view's Voronoi node, at the height of the view; without a node, that of the view."""
    positions = context.world_from_camera[:, :3, 3].copy()
    node = context.once(voronoi_node).astype(np.int64)
    positions[node >= 0, :2] = context.once(floor_graph).nodes[node[node >= 0]]
    return positions
