"""Compute the graph over the planes: weights, edges, spanning forest, betweenness, structural planes (Sec. 3.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.planes.vectors import distances
from activestructure_gym.ranges import check_ranges

_RANGES = {
    **dict.fromkeys(("beta", "max_edge_weight", "min_betweenness"), "[0, 1]"),
    "decay": "[0, 1e6]",
    **dict.fromkeys(("min_degree", "min_points"), "[0, 1000000000]"),
    "min_area": "[0, 1e9]",
}


@dataclass(frozen=True)
class TopologyConfig:
    """Configure Eqs. 4 and 5. The paper names the symbols; the values are this project's."""

    beta: float = 0.5  # Eq. 4: weight of the alignment of normals, 0..1; the rest is the weight of proximity
    decay: float = 0.5  # Eq. 4: lambda, decay of proximity per metre
    max_edge_weight: float = 0.95  # pairs of planes with a larger weight have no edge
    min_betweenness: float = 0.15  # Eq. 5: tau_c, least betweenness of a structural plane
    min_degree: int = 3  # Eq. 5: tau_d, least degree of a structural plane
    min_area: float = 1.5  # Eq. 5: tau_a, m^2, least area of a structural plane
    min_points: int = 400  # Eq. 5: tau_p, least number of points (one per cell) of a structural plane

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES)


def edge_weights(
    normals: np.ndarray,  # [N, 3] unit
    centroids: np.ndarray,  # [N, 3] metres, world
    *,
    beta: float = 0.5,  # weight of the alignment of normals, 0..1
    decay: float = 0.5,  # lambda, decay of proximity per metre
) -> np.ndarray:  # [N, N] in [0, 1], 0 on the diagonal
    """Return the edge weight of every pair of planes (Eq. 4). A small weight means parallel and close planes."""
    alignment = np.minimum((normals @ normals.T) ** 2, 1.0)
    distance = distances(centroids)
    weights = 1.0 - (beta * alignment + (1.0 - beta) * np.exp(-decay * distance))  # Eq. 4
    np.fill_diagonal(weights, 0.0)
    return np.clip(0.5 * (weights + weights.T), 0.0, 1.0)


def spanning_forest(
    weights: np.ndarray,  # [N, N] symmetric
    edges: np.ndarray,  # [N, N] bool symmetric
) -> np.ndarray:  # [N, N] bool symmetric
    """Return the edges of the minimum spanning tree of every connected component.

    Weights that agree to nine digits count as equal, and the lower indices are preferred. Symmetric rooms have equal
    weights, and rounding errors after a rotation must not change the choice.
    """
    count = len(weights)
    tree = np.zeros((count, count), bool)
    rows, columns = np.nonzero(np.triu(edges, 1))
    if not len(rows):
        return tree
    # The sort is stable: equal weights keep the order of rows, then columns.
    order = np.argsort(np.round(weights[rows, columns], 9), kind="stable")
    _join(rows[order], columns[order], tree)
    return tree


@kernel
def _join(rows: np.ndarray, columns: np.ndarray, tree: np.ndarray) -> None:
    """Add the edges (row, column) to ``tree`` [N, N], in order, that join two components (Kruskal's algorithm)."""
    above, left = np.arange(len(tree)), len(tree) - 1  # next node on the path to the root, edges still to add
    for n in range(len(rows)):
        one, other = rows[n], columns[n]
        while above[one] != one:
            above[one] = above[above[one]]
            one = above[one]
        while above[other] != other:
            above[other] = above[above[other]]
            other = above[other]
        if one != other:
            above[one] = other
            tree[rows[n], columns[n]] = tree[columns[n], rows[n]] = True
            left -= 1
            if not left:
                return


def tree_betweenness(tree: np.ndarray) -> np.ndarray:  # [N, N] bool symmetric, no cycles -> [N] in [0, 1]
    """Return the betweenness centrality of every node of a forest, normalised as in networkx.

    Without node u, its tree of n nodes has components of sizes s_k. The number of pairs whose path contains u is ((n -
    1)^2 - sum s_k^2) / 2. It is divided by the (N - 1)(N - 2) / 2 pairs of the whole graph. The cost is O(N) after the
    adjacency lists are built.
    """
    count = len(tree)
    if count < 3:
        return np.zeros(count)
    shares: np.ndarray = _separated_pairs(tree) * 2.0 / ((count - 1) * (count - 2))
    return shares


@kernel
def _separated_pairs(tree: np.ndarray) -> np.ndarray:  # [N] float64
    """Return the number of pairs of other nodes whose path contains each node of a forest [N, N]."""
    count = len(tree)
    pairs = np.zeros(count)
    parent, visited = np.full(count, -1), np.zeros(count, np.bool_)
    below, squares, order = np.ones(count, np.int64), np.zeros(count, np.int64), np.empty(count, np.int64)
    for root in range(count):
        if visited[root]:
            continue
        visited[root] = True
        order[0], size, head = root, 1, 0
        while head < size:  # breadth first
            for other in range(count):
                if tree[order[head], other] and not visited[other]:
                    visited[other] = True
                    parent[other] = order[head]
                    order[size] = other
                    size += 1
            head += 1
        for n in range(size - 1, -1, -1):
            node = order[n]
            rest = size - below[node]  # number of nodes that are not in the subtree of this node
            pairs[node] = ((size - 1) ** 2 - squares[node] - rest**2) / 2.0
            if parent[node] >= 0:
                below[parent[node]] += below[node]
                squares[parent[node]] += below[node] ** 2
    return pairs


def classify_structural(
    betweenness: np.ndarray,  # [N]
    degree: np.ndarray,  # [N] degree in the spanning forest
    area: np.ndarray,  # [N] m^2
    points: np.ndarray,  # [N] number of seen cells with a measured point
    config: TopologyConfig | None = None,
) -> np.ndarray:  # [N] bool
    """Return which planes are structural: planes that define the layout, such as walls (Eq. 5)."""
    config = config or TopologyConfig()
    large = (area >= config.min_area) & (points >= config.min_points)
    return (betweenness >= config.min_betweenness) | (degree >= config.min_degree) | large  # Eq. 5
