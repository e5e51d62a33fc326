"""Encode the Plane Scene Graph as arrays of fixed size for observations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.planes.quality import QUALITY_MODES
from activestructure_gym.planes.state import GraphState

# Metres. Offsets and centroids beyond this distance from the world's origin are clipped to it.
_FAR = 1000.0

# Columns of the feature table: name, lower and upper bound. Values are clipped to the bounds.
_COLUMNS: tuple[tuple[str, float, float], ...] = (
    ("normal_x", -1.0, 1.0),  # unit normal, world, towards the side from which the plane is observed
    ("normal_y", -1.0, 1.0),
    ("normal_z", -1.0, 1.0),
    ("offset", -_FAR, _FAR),  # metres; normal . x + offset = 0
    ("centroid_x", -_FAR, _FAR),  # metres, world: mean of the seen surface
    ("centroid_y", -_FAR, _FAR),
    ("centroid_z", -_FAR, _FAR),
    ("area", 0.0, 10_000.0),  # m^2 of seen surface
    ("points", 0.0, 4_000_000.0),  # number of seen cells with a measured point
    ("observations", 0.0, 100_000.0),  # number of keyframes that observed the plane
    *((f"quality_{mode}", 0.0, 1.0) for mode in QUALITY_MODES),  # s_1 .. s_8
    ("quality", 0.0, 1.0),  # q, Eq. 7: weighted mean of the modes
    ("surprise_connectivity", 0.0, 1.0),  # phi^c
    ("surprise_neighbourhood", 0.0, 1.0),  # phi^r, Eq. 8
    ("surprise_geometric", 0.0, 1.0),  # phi^g, Eq. 9
    ("surprise", 0.0, 1.0),  # Phi
    ("deficit", 0.0, 1.0),  # gamma, Eq. 10
    ("structural", 0.0, 1.0),  # 1 = structural plane, Eq. 5
    ("betweenness", 0.0, 1.0),  # betweenness centrality c_i in the spanning forest
    ("degree", 0.0, 1_000.0),  # number of edges in the spanning forest
)
PLANE_FEATURES: tuple[str, ...] = tuple(name for name, _, _ in _COLUMNS)
PLANE_FEATURE_LOW = np.array([low for _, low, _ in _COLUMNS], dtype=np.float32)
PLANE_FEATURE_HIGH = np.array([high for _, _, high in _COLUMNS], dtype=np.float32)
for _bound in (PLANE_FEATURE_LOW, PLANE_FEATURE_HIGH):
    _bound.setflags(write=False)


@dataclass(frozen=True)
class PlaneArrays:
    """Hold the Plane Scene Graph in ``max_planes`` rows, one per plane; unused rows are 0.

    With more planes than rows, the planes of largest area are kept. Rows are sorted by plane id, so the relative order
    of two planes is constant.
    """

    features: np.ndarray  # [max_planes, F] float32, columns PLANE_FEATURES, within PLANE_FEATURE_LOW and HIGH
    mask: np.ndarray  # [max_planes] int8, 1 = row with a plane
    edge_weights: np.ndarray  # [max_planes, max_planes] float32 Eq. 4, small = reliable, 0 = no edge
    tree: np.ndarray  # [max_planes, max_planes] int8, 1 = edge of the minimum spanning forest
    nodes: np.ndarray  # [K] int64: row k holds the plane of row nodes[k] of `GraphState`


def plane_features(state: GraphState) -> np.ndarray:  # [N, F] float32
    """Return the feature table of all planes with the columns PLANE_FEATURES, clipped to their bounds."""
    columns = [
        state.normals,
        state.offsets[:, None],
        state.centroids,
        state.areas[:, None],
        state.point_counts[:, None],
        state.observations[:, None],
        state.quality.modes,
        state.quality.scores[:, None],
        state.surprise.connectivity[:, None],
        state.surprise.neighbourhood[:, None],
        state.surprise.geometric[:, None],
        state.surprise.total[:, None],
        state.deficit[:, None],
        state.structural[:, None],
        state.betweenness[:, None],
        state.tree.sum(axis=1)[:, None],
    ]
    table = np.concatenate([np.asarray(column, dtype=np.float64) for column in columns], axis=1)
    return np.clip(table, PLANE_FEATURE_LOW, PLANE_FEATURE_HIGH).astype(np.float32)


def encode_planes(state: GraphState, max_planes: int) -> PlaneArrays:
    """Return the graph as arrays of fixed size with ``max_planes`` rows."""
    if max_planes < 1:
        raise ValueError(f"max_planes must be at least 1, got {max_planes}")
    kept = np.sort(np.argsort(-state.areas, kind="stable")[:max_planes])
    count = len(kept)
    features = np.zeros((max_planes, len(PLANE_FEATURES)), np.float32)
    mask = np.zeros(max_planes, np.int8)
    weights = np.zeros((max_planes, max_planes), np.float32)
    tree = np.zeros((max_planes, max_planes), np.int8)
    if count:
        pairs = np.ix_(kept, kept)
        features[:count] = plane_features(state)[kept]
        mask[:count] = 1
        # An entry of 0 means "no edge", so weights are at least 1e-6.
        weights[:count, :count] = np.where(state.edges[pairs], np.maximum(state.weights[pairs], 1e-6), 0.0)
        tree[:count, :count] = state.tree[pairs]
    return PlaneArrays(features, mask, weights, tree, kept.astype(np.int64))
