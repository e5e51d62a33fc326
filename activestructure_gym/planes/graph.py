"""Maintain the Plane Scene Graph G = (V, E): planes as nodes, observed relations as edges (Sec. 3.2 and 3.3)."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from activestructure_gym.compiling.thread_team import default_threads
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.planes.arrays import PlaneArrays, encode_planes
from activestructure_gym.planes.detection import (
    PlaneDetection,
    PlaneDetectionConfig,
    PlaneSegment,
    segment_planes,
)
from activestructure_gym.planes.matching import MatchingConfig, match_segment, may_be_same, same_surface, stack_planes
from activestructure_gym.planes.nodes import PlaneNode
from activestructure_gym.planes.quality import (
    Deficiencies,
    QualityConfig,
    SpaceState,
    assess_quality,
    coarse_patches,
    find_deficiencies,
)
from activestructure_gym.planes.sparseness import MapPoints, SparsePatches
from activestructure_gym.planes.state import GraphState
from activestructure_gym.planes.surface import observe
from activestructure_gym.planes.surprise import SurpriseConfig, information_deficit, structural_surprise
from activestructure_gym.planes.topology import (
    TopologyConfig,
    classify_structural,
    edge_weights,
    spanning_forest,
    tree_betweenness,
)
from activestructure_gym.planes.vectors import cross, length
from activestructure_gym.ranges import check_ranges

if TYPE_CHECKING:
    import networkx

_RANGES = {
    "cell": "[0.001, 100]",
    "min_node_area": "[0, 1e9]",
    "fusion_rate": "[0, 1]",
    "normal_window": "[1, 1000000]",
}


@dataclass(frozen=True)
class PlaneGraphConfig:
    """Configure all steps of the plane processing."""

    enabled: bool = True  # False: no planes are detected, and all arrays of planes are 0
    detection: PlaneDetectionConfig = field(default_factory=PlaneDetectionConfig)
    matching: MatchingConfig = field(default_factory=MatchingConfig)
    topology: TopologyConfig = field(default_factory=TopologyConfig)
    quality: QualityConfig = field(default_factory=QualityConfig)
    surprise: SurpriseConfig = field(default_factory=SurpriseConfig)
    cell: float = 0.05  # side of a cell of a plane's grid, metres
    # m^2; smaller segments can be fused into a plane but do not create one. They justify no view of their own, and
    # slats, legs and book spines would otherwise be most of the planes.
    min_node_area: float = 0.05
    fusion_rate: float = 0.3  # weight of a new observation in the exponential moving average of normal and offset
    normal_window: int = 10  # number of keyframes whose observed normals a plane keeps

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES)


NO_NODE = -1


class PlaneSceneGraph:
    """Hold the planes of a scene and their relations, updated keyframe by keyframe.

    ``state`` is the result of the last `assess`, which `update` runs at its end. The same holds for the deficiencies,
    if they are read before the next keyframe. Equal frames give equal graphs, since nothing is random.
    """

    state: GraphState  # rows in the order of `nodes` at the last `assess`

    def __init__(self, config: PlaneGraphConfig | None = None) -> None:
        self.config = config or PlaneGraphConfig()
        self.nodes: list[PlaneNode] = []  # sorted by id
        self.keyframes = 0  # number of keyframes fused
        self._next_id = 0
        self._map_points: MapPoints | None
        self._coarse: SparsePatches | None
        self._deficiencies: Deficiencies | None
        self.assess()

    def update(
        self, frame: Frame, *, space_state: SpaceState | None = None, map_points: MapPoints | None = None
    ) -> None:
        """Detect the planes of a keyframe, fuse them into the graph, and assess the graph; arguments as in `assess`."""
        self.integrate(frame)
        self.assess(space_state=space_state, map_points=map_points)

    def integrate(self, frame: Frame, detection: PlaneDetection | None = None) -> None:
        """Fuse the segments of a keyframe into the planes; by default the segments are detected in the frame.

        The graph is not assessed: an agent takes several keyframes between two decisions, and only the state at a
        decision is used.
        """
        if detection is None:
            if not self.config.enabled:
                self.keyframes += 1
                return
            detection = segment_planes(frame, self.config.detection)
        owner = self._assign(frame, detection.segments)
        touched = sorted(set(owner) - {NO_NODE})
        if touched:
            self._fuse(frame, detection, owner, touched)
            self._merge(touched)
        self.keyframes += 1

    def node(self, node_id: int) -> PlaneNode:
        """Return the plane with this id; raise KeyError if it was merged into another plane or never existed."""
        for node in self.nodes:
            if node.id == node_id:
                return node
        raise KeyError(node_id)

    def _assign(self, frame: Frame, segments: tuple[PlaneSegment, ...]) -> list[int]:
        """Return the plane id of every segment. Unmatched segments create planes, which later segments may match."""
        eye = np.asarray(frame.world_from_camera, dtype=np.float64)[:3, 3]
        right = np.asarray(frame.world_from_camera, dtype=np.float64)[:3, 0]
        planes = stack_planes(self.nodes)
        owner = []
        for segment in segments:
            index = match_segment(segment, eye, self.nodes, planes, self.config.matching)
            if index is None and segment.area < self.config.min_node_area:
                owner.append(NO_NODE)
                continue
            if index is None:
                self.nodes.append(
                    PlaneNode(
                        self._next_id,
                        segment,
                        tangent_axes(segment, right),
                        cell=self.config.cell,
                        window=self.config.normal_window,
                    )
                )
                self._next_id += 1
                index = len(self.nodes) - 1
                planes = np.concatenate([planes, stack_planes(self.nodes[-1:])])
            owner.append(self.nodes[index].id)
        return owner

    def _fuse(self, frame: Frame, detection: PlaneDetection, owner: list[int], touched: list[int]) -> None:
        nodes = [self.node(node_id) for node_id in touched]
        row = {node_id: k for k, node_id in enumerate(touched)} | {NO_NODE: -1}
        patches, moments = observe(
            frame,
            detection,
            np.array([row[node_id] for node_id in owner]),
            [node.surface for node in nodes],
            np.array([node.anchor for node in nodes]),
            reach=self.config.quality.boundary_reach,
            config=self.config.detection,
        )
        for k, node in enumerate(nodes):
            own = [segment for segment, node_id in zip(detection.segments, owner) if node_id == node.id]
            node.fuse(own, patches[k], moments[k], self.keyframes, self.config.fusion_rate)

    def _merge(self, touched: list[int]) -> None:
        """Merge planes that satisfy the coplanar mode after their update.

        ``touched`` are the ids of the updated planes. The smaller id, that of the older plane, is kept.
        """
        queue = list(touched)
        near = may_be_same(self.nodes, self.config.matching)
        while queue:
            node_id = queue.pop(0)
            node = next((n for n in self.nodes if n.id == node_id and n.id in near), None)
            if node is None:
                continue
            for other in [self.nodes[k] for k in near[node_id]]:
                if same_surface(node, other, self.config.matching):
                    kept, gone = sorted((node, other), key=lambda n: n.id)
                    kept.absorb(gone)
                    self.nodes.remove(gone)
                    near = may_be_same(self.nodes, self.config.matching)
                    queue.append(kept.id)  # the merged plane may reach other planes
                    break

    def assess(self, *, space_state: SpaceState | None = None, map_points: MapPoints | None = None) -> None:
        """Compute edges, spanning forest, quality, surprise, deficit and deficiencies of the current planes.

        ``space_state`` is a function that returns whether world points are unknown (0), free (1) or occupied (2).
        Without it, only planes and images close a boundary (mode v). ``map_points`` are the Gaussians of the map.
        Without them, only holes are deficient, and not areas that the map covers too coarsely.
        """
        self._map_points, self._coarse, self._deficiencies = map_points, None, None
        if not self.nodes and self.keyframes:
            return  # the state is that of an empty graph from the start: planes are never all removed
        if map_points is None or default_threads() == 1:
            self._assess(space_state)
            return
        # Both computations only read the planes, and the kernels of `coarse_patches` release the GIL.
        with ThreadPoolExecutor(1) as aside:
            future = aside.submit(coarse_patches, self.nodes, self.config.quality, map_points)
            self._assess(space_state)
        self._coarse = future.result()

    @property
    def deficiencies(self) -> Deficiencies:
        """Return the holes and the coarsely mapped areas of all planes. They are computed at the first use."""
        if self._deficiencies is None:
            if self._coarse is None and self._map_points is not None:
                self._coarse = coarse_patches(self.nodes, self.config.quality, self._map_points)
            self._deficiencies = find_deficiencies(self.nodes, self.config.quality, coarse=self._coarse)
        return self._deficiencies

    def _assess(self, space_state: SpaceState | None) -> None:
        nodes, config = self.nodes, self.config
        planes = stack_planes(nodes)
        normals, centroids = planes[:, :3].copy(), planes[:, 4:].copy()
        areas = np.array([node.area for node in nodes], dtype=np.float64)
        point_counts = np.array([node.point_count for node in nodes], dtype=np.int64)
        topology = config.topology
        weights = edge_weights(normals, centroids, beta=topology.beta, decay=topology.decay)
        edges = self._seen_together() & (weights <= topology.max_edge_weight)
        tree = spanning_forest(weights, edges)
        betweenness = tree_betweenness(tree)
        structural = classify_structural(betweenness, tree.sum(axis=1), areas, point_counts, topology)
        quality = assess_quality(nodes, structural, config.quality, space_state=space_state)
        surprise = structural_surprise(normals, centroids, edges, tree, config.surprise)
        self.state = GraphState(
            ids=np.array([node.id for node in nodes], dtype=np.int64),
            normals=normals,
            offsets=planes[:, 3].copy(),
            centroids=centroids,
            areas=areas,
            point_counts=point_counts,
            observations=np.array([node.observations for node in nodes], dtype=np.int64),
            weights=weights,
            edges=edges,
            tree=tree,
            betweenness=betweenness,
            structural=structural,
            quality=quality,
            surprise=surprise,
            deficit=information_deficit(quality.scores, surprise.total),
        )

    def _seen_together(self) -> np.ndarray:  # [N, N] bool
        """Return the pairs of planes that were observed together in at least one keyframe."""
        size = self.keyframes // 8 + 1  # bytes
        packed = b"".join(node.keyframes.to_bytes(size, "little") for node in self.nodes)
        shows = np.unpackbits(np.frombuffer(packed, np.uint8).reshape(len(self.nodes), size), axis=1)
        shows = shows.astype(np.float32)  # [N, keyframes]; sums are exact below 2^24
        together = shows @ shows.T > 0
        np.fill_diagonal(together, False)
        return together

    def arrays(self, max_planes: int) -> PlaneArrays:
        """Return the graph in arrays with ``max_planes`` rows; with more planes, the largest by area are kept."""
        return encode_planes(self.state, max_planes)

    def sample_points(self, count: int) -> tuple[np.ndarray, np.ndarray]:  # [N, count, 3], [N, count] bool
        """Return up to ``count`` evenly distributed points of each plane, for visibility tests, and their mask."""
        points = np.zeros((len(self.nodes), count, 3))
        exists = np.zeros((len(self.nodes), count), bool)
        for k, node in enumerate(self.nodes):
            own = node.surface.points(count)
            points[k, : len(own)] = own
            exists[k, : len(own)] = True
        return points, exists

    def as_networkx(self) -> networkx.Graph:
        """Return the graph for networkx: planes by id with their values, edges with ``weight`` and ``tree``."""
        import networkx

        graph, state = networkx.Graph(), self.state
        for k, node in enumerate(self.nodes):
            graph.add_node(
                node.id,
                normal=node.normal.copy(),
                offset=node.offset,
                centroid=state.centroids[k].copy(),
                area=node.area,
                points=node.points,
                observations=node.observations,
                structural=bool(state.structural[k]),
                betweenness=float(state.betweenness[k]),
                modes=state.quality.modes[k].copy(),
                quality=float(state.quality.scores[k]),
                surprise=float(state.surprise.total[k]),
                deficit=float(state.deficit[k]),
            )
        for i, j in zip(*np.nonzero(np.triu(state.edges, 1))):
            graph.add_edge(
                self.nodes[i].id, self.nodes[j].id, weight=float(state.weights[i, j]), tree=bool(state.tree[i, j])
            )
        return graph


def tangent_axes(segment: PlaneSegment, camera_right: np.ndarray) -> np.ndarray:  # [3, 3] rows u, v, normal
    """Return the tangent frame of a segment by singular value decomposition of its points (Eq. 6).

    u is the long direction of the segment, with its sign towards the image's right axis ``camera_right`` [3]. A segment
    without a long direction gets the right axis itself. So the frame moves with a rigid motion of scene and camera.
    """
    normal = segment.normal
    centred = segment.points - segment.points.mean(axis=0)
    centred = centred - (centred @ normal)[:, None] * normal
    _, spread, directions = np.linalg.svd(centred, full_matrices=False)
    sideways = camera_right - (camera_right @ normal) * normal
    if len(spread) > 1 and spread[0] > 1.02 * spread[1] and spread[0] > 1e-9:
        u = directions[0] - (directions[0] @ normal) * normal
        u = u if u @ sideways >= 0 else -u
    elif length(sideways) > 1e-6:
        u = sideways
    else:  # the camera looks along the plane, so only the world's axes remain
        u = cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    u = u / length(u)
    return np.array([u, cross(normal, u), normal])
