"""Compute ANM-S's features: clusters of uncertain surface at a Voronoi node, and the ends of its cut branches.

A cut branch leads from a node of the Voronoi graph to an end without a junction; `planar_graph` removes it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.in_horizon import in_sight_within, last_moved, returns
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.uncertain_surface import (
    Clusters,
    Surface,
    by_perturbing_means,
    by_proxy,
    clusters,
)
from activestructure_gym.features.voronoi_node import floor_graph, voronoi_node
from activestructure_gym.geometry import look_along

KEPT = 0.2  # share of the surface that is clustered, the most uncertain part
# Metres from the camera's first height to the agent's head; higher surface has no clusters (1.25 m and 1.5 m).
CAMERA_TO_HEAD = 0.25
SAME_VIEW = float(np.cos(np.radians(45.0)))  # cosine; one view serves all directions within 45 degrees of it


_COLUMNS: dict[str, Any] = {
    "columns": ("clusters", "looks", "facing"),
    "unit": ("clusters", "views", "cosine"),
    "low": (0.0, 0.0, -1.0),
    "high": (np.inf, np.inf, 1.0),
}


@FEATURES.register("anm_s_horizon", unit="0 or 1", low=0.0, high=1.0)
def anm_s_horizon(context: FeatureContext) -> np.ndarray:  # [K] 0 or 1
    """Return 1 where the line to the view's node on the plan is free and ends inside the horizon, else 0.

    The horizon is the bounding box of `ahead`, the last movement's view, in the floor plane. If no node with a free
    line is inside it, all nodes with a free line count. Source: [anm_s, code].
    """
    return in_sight_within(context, ahead(context))


def ahead(context: FeatureContext) -> np.ndarray:  # [n, 3] metres, world
    """Return the occupied voxels that a level camera sees from the keyframe `last_moved`, along the last movement.

    The original's agent looks along its movement and turns only at the node. Here the camera of this keyframe may have
    turned towards the goal. Without a movement or such voxels, the depth returns and the position of the keyframe are
    returned.
    """
    keyframes, volume = context.mapper.keyframes, context.volume
    frame, here = last_moved(keyframes), last_moved(keyframes).world_from_camera[:3, 3]
    number = next(n for n, other in enumerate(keyframes) if other is frame)
    movement = (here - keyframes[max(number - 1, 0)].world_from_camera[:3, 3]) * [1.0, 1.0, 0.0]
    seen = np.zeros((0, 3), dtype=np.int64)
    if movement.any():
        rays = volume.rays(context.camera, look_along(here, movement), reach=context.max_range)
        seen = np.argwhere(rays.seen() & volume.occupied)
    return volume.center_of(seen) if len(seen) else np.vstack([returns(frame), here])


@FEATURES.register("anm_s", **_COLUMNS)
def anm_s(context: FeatureContext) -> np.ndarray:  # [K, 3]
    """Compute, at the candidate's Voronoi node, the numbers of uncertain clusters and of views of them, and a cosine.

    A cluster is a connected part of the most uncertain 20 % of the surface below the agent's head. The first column
    counts the clusters whose nearest node is the candidate's. The second is the number of views that see these clusters
    and, if there are any, the ends of the cut branches of the node. The third is the cosine between the candidate's
    view direction and the nearest direction to one of them. The uncertainty comes from 20 renderings of the map with
    perturbed means. Source: [anm_s, code].
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
    - Number of views needed to see these clusters and the ends of the cut branches of the node; 0 without clusters.
    - Cosine between the candidate's view direction and the nearest direction to one of these; -1 if there is none.

    Directions are horizontal, since the original's agent only turns, and lead to the target of a cluster.
    """
    head = context.mapper.keyframes[0].world_from_camera[2, 3] + CAMERA_TO_HEAD
    found = clusters(context.once(uncertainty).below(head), KEPT)
    graph = context.once(floor_graph)
    node, poses = context.once(voronoi_node).astype(np.int64), context.world_from_camera
    anchors = anchored(found, graph.nodes)
    table = np.tile([0.0, 0.0, -1.0], (len(poses), 1))
    for n in np.unique(anchors[anchors >= 0]):
        targets = found.targets[anchors == n, :2]
        shown = np.concatenate([targets, graph.chain_ends[graph.chain_nodes == n]])
        for row in np.flatnonzero(node == n):
            offsets = shown - poses[row, :2, 3]
            lengths = np.linalg.norm(offsets, axis=1, keepdims=True)
            flat = (offsets / np.maximum(lengths, 1e-9))[lengths[:, 0] > 1e-6]  # none at the candidate itself
            directions = np.column_stack([flat, np.zeros(len(flat))])
            table[row] = len(targets), count_views(directions), (directions @ poses[row, :3, 2]).max(initial=-1.0)
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
