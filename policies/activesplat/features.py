"""Compute ActiveSplat's features: missing information and volume around Voronoi nodes, and gaps in a view."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.hole_area import solid_angles
from activestructure_gym.features.median_depth import median_depths
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.voronoi_node import floor_graph, places, voronoi_node
from activestructure_gym.motion import VoronoiGraph
from activestructure_gym.views import panorama

REGION_M = 2.0  # metres; groups of nodes with a larger average distance are different subregions
APART_M = 1e3  # metres, path length between nodes that no path connects
VIEW_OPEN = 0.3  # minimum 1 - opacity of a gap in a view
MIN_VIEW_DEG2 = 100.0  # square degrees; smaller gaps in a view are ignored (25 pixels of 2 x 2 degrees)


@FEATURES.register(
    "activesplat",
    columns=("information", "volume", "region", "view", "x", "y"),
    unit=("rad^2 m deg^2", "rad^2 m", "index", "deg^2", "m", "m"),
    low=(0.0, 0.0, -1.0, 0.0, -np.inf, -np.inf),
)
def activesplat(context: FeatureContext) -> np.ndarray:  # [K, 6]
    """Compute I, V, subregion and position of the candidate's Voronoi node, and the gaps (deg^2) in its own image.

    I (rad^2 m deg^2) sums (hull volume) x (sum of 1 - opacity) over clusters of gaps in the node's panorama. V
    (rad^2 m) sums the hull volumes. Both are 0 without a node. The number of a subregion is valid in one step only; it
    is -1 without a node. The column ``view`` sums 1 - opacity over the gaps of more than 100 square degrees in the
    image. The last two columns are the node's position (m, world), or the candidate's own without a node. Source:
    [activesplat, code].
    """
    information, volume = node_openings(context)
    region = regions(context.once(floor_graph)).astype(np.float64)
    of_node = [_of_node(context, information), _of_node(context, volume), _of_node(context, region, nothing=-1.0)]
    return np.column_stack([*of_node, visible_gaps(context), places(context)[:, :2]])


def visible_gaps(context: FeatureContext) -> np.ndarray:  # [K] square degrees
    """Return the sum of 1 - opacity over the gaps of more than 100 square degrees in the image of each candidate.

    A gap is a connected region of pixels with 1 - opacity above 0.3. The original finds gaps in the panorama of the
    agent's node and turns to their centres. Here the view directions of the candidates are given.
    """
    missing = 1.0 - context.alpha
    degrees = missing * solid_angles(context.camera) * np.degrees(1.0) ** 2
    total = np.zeros(len(missing))
    for k, mask in enumerate(missing > VIEW_OPEN):
        if mask.any():
            count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
            gaps = np.bincount(labels.ravel(), weights=degrees[k].ravel(), minlength=count)[1:]
            total[k] = gaps[gaps > MIN_VIEW_DEG2].sum()
    return total


def regions(graph: VoronoiGraph) -> np.ndarray:  # [N] int64, from 1
    """Return the number of the subregion of each of the N nodes, found by hierarchical clustering (average linkage).

    The distance of two nodes is the mean of their path length and their straight distance. Subregions with a larger
    average distance than 2 m are separate.
    """
    if len(graph) < 2:
        return np.ones(len(graph), dtype=np.int64)
    straight = np.linalg.norm(graph.nodes[:, None] - graph.nodes, axis=2)
    distance = 0.5 * np.minimum(graph.distances, APART_M) + 0.5 * straight
    tree = linkage(squareform(0.5 * (distance + distance.T), checks=False), method="average")
    return fcluster(tree, REGION_M, criterion="distance").astype(np.int64)


def node_openings(context: FeatureContext) -> tuple[np.ndarray, np.ndarray]:  # [N], [N]
    """Return I and V (see `activesplat`) of each of the N Voronoi nodes, from panoramas of the map at the nodes.

    They are 0 for nodes without candidates. The original also sets them to 0 within 0.2 m of obstacles. All nodes of
    our graph are farther away.
    """
    graph = context.once(floor_graph)
    information, volume = np.zeros(len(graph)), np.zeros(len(graph))
    found = np.unique(context.once(voronoi_node)).astype(np.int64)
    wanted = found[found >= 0]
    if not len(wanted):
        return information, volume
    height = context.mapper.keyframes[0].world_from_camera[2, 3]
    positions = np.column_stack([graph.nodes[wanted], np.full(len(wanted), height)])
    camera, poses = panorama.camera(), panorama.poses(positions)
    alphas = panorama.side_by_side(context.mapper.render_depth_alpha(camera, poses)[1])
    depths = panorama.side_by_side(median_depths(context.mapper.map, camera, poses))
    for n, depth, alpha in zip(wanted, depths, alphas):
        openings = panorama.openings(alpha, depth)
        information[n] = sum(opening.volume * opening.missing for opening in openings)
        volume[n] = sum(opening.volume for opening in openings)
    return information, volume


def _of_node(context: FeatureContext, values: np.ndarray, nothing: float = 0.0) -> np.ndarray:  # [N] -> [K]
    """Return, for each of K candidates, the value of its Voronoi node; ``nothing`` without a node."""
    node = context.once(voronoi_node).astype(np.int64)
    return np.append(values, nothing)[np.where(node >= 0, node, -1)]
