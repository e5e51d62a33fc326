"""Compute ActiveSplat's features: missing information and volume around Voronoi nodes, and gaps in a view."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.hole_area import solid_angles
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.voronoi_node import NODE_REACH, floor_graph, voronoi_node
from activestructure_gym.motion import VoronoiGraph
from activestructure_gym.sensors import Frame
from activestructure_gym.views import panorama

RADIUS = 0.2  # metres, radius of the agent in ActiveSplat
REGION_M = 2.0  # metres; groups of nodes with a larger average distance are different subregions
APART_M = 1e3  # metres, path length between nodes that no path connects
VIEW_OPEN = 0.3  # minimum 1 - opacity of a gap in a view
MIN_VIEW_DEG2 = 25.0  # square degrees; smaller gaps in a view are ignored


@FEATURES.register(
    "activesplat",
    columns=("information", "volume", "region", "view"),
    unit=("rad^2 m deg^2", "rad^2 m", "index", "deg^2"),
    low=(0.0, 0.0, -1.0, 0.0),
)
def activesplat(context: FeatureContext) -> np.ndarray:  # [K, 4]
    """Compute I, V and the subregion of the candidate's Voronoi node, and the gaps (deg^2) visible in its own image.

    I (rad^2 m deg^2) sums (hull volume) x (sum of 1 - opacity) over clusters of gaps in the node's panorama. V
    (rad^2 m) sums the hull volumes. Both are 0 without a node. The number of a subregion is valid in one step only; it
    is -1 without a node. The last column sums 1 - opacity over the gaps of more than 25 square degrees in the image.
    Source: [activesplat, code].
    """
    information, volume = node_openings(context)
    region = regions(context.once(floor_graph)).astype(np.float64)
    of_node = [_of_node(context, information), _of_node(context, volume), _of_node(context, region, nothing=-1.0)]
    return np.column_stack([*of_node, visible_gaps(context)])


def visible_gaps(context: FeatureContext) -> np.ndarray:  # [K] square degrees
    """Return the sum of 1 - opacity over the gaps of more than 25 square degrees in the image of each candidate.

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


def has_full_turn(place: np.ndarray, keyframes: list[Frame]) -> bool:  # [2] metres
    """Return whether the keyframes within 0.5 m of ``place`` together show all 36 azimuth bins of 10 degrees."""
    seen = np.zeros(36, dtype=bool)
    bins = np.radians(10.0) * (np.arange(36) + 0.5)
    for frame in keyframes:
        pose, camera = frame.world_from_camera, frame.camera
        if np.linalg.norm(pose[:2, 3] - place) <= NODE_REACH:
            turned = (bins - np.arctan2(pose[1, 2], pose[0, 2]) + np.pi) % (2.0 * np.pi) - np.pi
            seen |= np.abs(turned) <= np.arctan(0.5 * camera.width / camera.fx)
    return bool(seen.all())


def node_openings(context: FeatureContext) -> tuple[np.ndarray, np.ndarray]:  # [N], [N]
    """Return I and V (see `activesplat`) of each of the N Voronoi nodes, from panoramas of the map at the nodes.

    They are 0 for nodes without candidates, for nodes within 0.4 m of obstacles, and where keyframes show all azimuths.
    """
    graph, keyframes = context.once(floor_graph), context.mapper.keyframes
    information, volume = np.zeros(len(graph)), np.zeros(len(graph))
    wanted = [
        int(n)
        for n in np.unique(context.once(voronoi_node))
        if n >= 0 and graph.clearance[int(n)] > 2.0 * RADIUS and not has_full_turn(graph.nodes[int(n)], keyframes)
    ]
    if not wanted:
        return information, volume
    height = keyframes[0].world_from_camera[2, 3]
    positions = np.column_stack([graph.nodes[wanted], np.full(len(wanted), height)])
    images = context.mapper.render_depth_alpha(panorama.camera(), panorama.poses(positions))
    depths, alphas = (panorama.side_by_side(image) for image in images)
    for n, depth, alpha in zip(wanted, depths, alphas):
        found = panorama.openings(alpha, depth)
        information[n] = sum(opening.volume * opening.missing for opening in found)
        volume[n] = sum(opening.volume for opening in found)
    return information, volume


def _of_node(context: FeatureContext, values: np.ndarray, nothing: float = 0.0) -> np.ndarray:  # [N] -> [K]
    """Return, for each of K candidates, the value of its Voronoi node; ``nothing`` without a node."""
    node = context.once(voronoi_node).astype(np.int64)
    return np.append(values, nothing)[np.where(node >= 0, node, -1)]
