"""Compute the Voronoi graph of a floor plan: positions with locally maximal distance to walls, and their connections.

The planners ActiveSplat and ANM-S choose among its nodes ([activesplat, code], [anm_s, code]).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import networkx as nx
import numpy as np
from scipy.spatial import QhullError, Voronoi

from activestructure_gym.volume import FREE, OCCUPIED, VoxelVolume

SIMPLIFIED_M = 0.225  # metres: tolerance of the simplification of the outline (ActiveSplat's value)
SPACING_M = 0.2  # metres between points on the outline
MERGED_M = 0.5  # metres: nodes closer than this along the graph are merged
# Two points of an outline are on different parts if the outline between them is longer than the straight line by this
# factor.
_DETOUR = 1.2
_SPECK = 4  # cells: unknown islands of up to this size count as free
# Metres above the ground: occupied space in between blocks the agent (own choice). The agents of ActiveSplat and ANM-S
# reach to 1.5 m.
FOOT_M, HEAD_M = 0.25, 2.0


@dataclass(frozen=True)
class VoronoiGraph:
    """Hold a Voronoi graph. Nodes are vertices of degree 3 or more.

    A chain is a branch that ends without reaching a second node. Chains are not part of the graph, but their ends are
    kept.
    """

    nodes: np.ndarray  # [N, 2] metres, world, sorted by coordinates
    clearance: np.ndarray  # [N] metres from the node to the outline
    edges: np.ndarray  # [E, 2] int64 node indices, the smaller first
    lengths: np.ndarray  # [E] length of each edge along the graph, metres
    chain_ends: np.ndarray  # [C, 2] metres: ends of the removed chains
    chain_nodes: np.ndarray  # [C] int64 node at which each chain began

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def distances(self) -> np.ndarray:  # [N, N] metres along the graph, inf if not connected
        """Return the shortest path lengths between all pairs of nodes."""
        graph = nx.Graph()
        graph.add_nodes_from(range(len(self)))
        graph.add_weighted_edges_from((int(a), int(b), float(d)) for (a, b), d in zip(self.edges, self.lengths))
        table = np.full((len(self), len(self)), np.inf)
        for start, ways in nx.all_pairs_dijkstra_path_length(graph):
            table[start, list(ways)] = list(ways.values())
        return table


def planar_graph(
    volume: VoxelVolume,
    position: np.ndarray,  # [3] metres, world: inside the plan, at the plan's height
) -> VoronoiGraph:
    """Return the Voronoi graph of the free space at the height of ``position`` that is connected to it."""
    return voronoi_graph(free_plan(volume, position), volume.origin[:2], volume.voxel_size)


def free_plan(volume: VoxelVolume, position: np.ndarray) -> np.ndarray:  # [X, Y] bool
    """Return the cells free for an agent that are connected to ``position`` [3]; all False if there are none.

    A cell is free at the height of ``position``, and nothing is occupied from 0.25 to 2 m above the ground. The ground
    is the most frequent height of the first occupied voxel below; if none is known, the agent's height alone counts.
    Unknown islands of up to 4 cells in free space, which all rays missed, count as free. If the cell of ``position`` is
    blocked, as above a table, the nearest free cell takes its place.
    """
    i, j, k = volume.voxel_of(position)
    plan = np.zeros(volume.shape[:2], dtype=bool)
    if not volume.contains(position):
        return plan
    layer = volume.state[:, :, k]
    free = layer == FREE
    count, labels, stats, _ = cv2.connectedComponentsWithStats((~free).astype(np.uint8), connectivity=8)
    solid = np.bincount(labels.ravel(), weights=(layer == OCCUPIED).ravel(), minlength=count) > 0
    free |= ((stats[:, cv2.CC_STAT_AREA] <= _SPECK) & ~solid)[labels]
    if not free[i, j]:
        return plan
    free &= ~_blocked(volume, free, k)
    if not free.any():
        return plan
    _, labels = cv2.connectedComponents(free.astype(np.uint8), connectivity=4)
    cells = np.argwhere(free)
    here = cells[np.square(cells - [i, j]).sum(axis=1).argmin()]
    return free & (labels == labels[tuple(here)])


def _blocked(volume: VoxelVolume, free: np.ndarray, layer: int) -> np.ndarray:  # [X, Y] bool, [X, Y] bool
    """Return the cells with an occupied voxel between foot and head, over the ground below the ``free`` ones."""
    occupied = volume.state == OCCUPIED
    below = occupied[:, :, :layer][free]  # [n, layer]
    below = below[below.any(axis=1)]
    if not len(below):
        return np.zeros(free.shape, dtype=bool)
    ground = layer - np.bincount(below[:, ::-1].argmax(axis=1)).argmax()  # first voxel above the ground
    foot, head = (ground + round(height / volume.voxel_size) for height in (FOOT_M, HEAD_M))
    return np.asarray(occupied[:, :, foot:head].any(axis=2))


def voronoi_graph(
    free: np.ndarray,  # [X, Y] bool free cells
    origin: np.ndarray,  # [2] metres, lower corner of cell (0, 0)
    cell: float,  # metres
    *,
    radius: float = 0.2,  # metres, least distance of nodes and edges to the outline
) -> VoronoiGraph:
    """Return the Voronoi graph of free cells.

    A single node if it has no branches, an empty graph if nothing has clearance. The outline of the free cells is
    simplified and sampled. Of the Voronoi diagram of the samples, the edges between different parts of the outline are
    kept. The outline runs through the centres of the outermost free cells, so clearances are half a cell too small.
    """
    graph = _skeleton(free, cell, radius)
    if not len(graph):
        return _lonely(free, origin, cell, radius)
    junctions = {v for v, degree in graph.degree if degree >= 3}
    if not junctions:  # a path or a ring: the position with the largest clearance becomes the only node
        widest = max(graph, key=lambda v: (graph.nodes[v]["clearance"], v))
        at = np.asarray(origin) + graph.nodes[widest]["at"]
        return _assembled(at[None], np.array([graph.nodes[widest]["clearance"]]), {}, [])
    ways, chains = _contracted(graph, junctions)
    leader = _merged(graph, junctions, ways)
    order = sorted(set(leader.values()), key=lambda v: tuple(graph.nodes[v]["at"]))
    number = {v: n for n, v in enumerate(order)}
    edges: dict[tuple[int, int], float] = {}
    for a, b, length in ways:
        first, second = sorted((number[leader[a]], number[leader[b]]))
        to_leaders = sum(float(np.linalg.norm(graph.nodes[v]["at"] - graph.nodes[leader[v]]["at"])) for v in (a, b))
        if first != second:
            edges[first, second] = min(length + to_leaders, edges.get((first, second), np.inf))
    return _assembled(
        np.asarray(origin) + np.array([graph.nodes[v]["at"] for v in order]),
        np.array([graph.nodes[v]["clearance"] for v in order]),
        edges,
        [(np.asarray(origin) + graph.nodes[end]["at"], number[leader[v]]) for v, end in chains],
    )


def _skeleton(free: np.ndarray, cell: float, radius: float) -> nx.Graph:
    """Return the Voronoi vertices in free cells, and the edges at least ``radius`` metres from the outline.

    Positions are in metres from the corner of cell (0, 0).
    """
    points, contour, along, whole = _outline(free, cell)
    graph = nx.Graph()
    if len(points) < 4:
        return graph
    try:
        diagram = Voronoi(points)
    except QhullError:  # collinear points
        return graph
    ridges, pairs = np.array(diagram.ridge_vertices), diagram.ridge_points
    gap = np.abs(along[pairs[:, 0]] - along[pairs[:, 1]])
    around = np.minimum(gap, whole[contour[pairs[:, 0]]] - gap)  # the shorter part of a closed outline
    straight = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    branches = (contour[pairs[:, 0]] != contour[pairs[:, 1]]) | (around > _DETOUR * straight)
    vertices = diagram.vertices
    clearance = np.full(len(vertices), np.inf)
    for end in (0, 1):
        distance = np.linalg.norm(vertices[ridges[:, end]] - points[pairs[:, 0]], axis=1)
        np.minimum.at(clearance, ridges[:, end], distance)
    # Where an edge passes between its two points, as in a door, its closest position to them is between its ends.
    begin, way = vertices[ridges[:, 0]], vertices[ridges[:, 1]] - vertices[ridges[:, 0]]
    share = ((points[pairs[:, 0]] - begin) * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-12)
    closest = begin + np.clip(share, 0.0, 1.0)[:, None] * way
    branches &= np.linalg.norm(closest - points[pairs[:, 0]], axis=1) > radius
    cells = np.floor(vertices / cell).astype(np.int64)
    inside = ((cells >= 0) & (cells < free.shape)).all(axis=1)
    inside[inside] = free[tuple(cells[inside].T)]
    good = inside & (clearance > radius)
    for (a, b), branch in zip(ridges.tolist(), branches):
        if branch and a >= 0 and good[a] and good[b]:
            graph.add_edge(a, b, length=float(np.linalg.norm(vertices[a] - vertices[b])))
    for v in graph:
        graph.nodes[v]["at"], graph.nodes[v]["clearance"] = vertices[v], float(clearance[v])
    return graph


def _outline(free: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return points along the simplified outlines of the free cells; ``cell`` is the size of a cell in metres.

    Returns points [P, 2] in metres, the index of each point's outline [P], its position along the outline [P] in
    metres, and the length of each outline in metres.
    """
    found, _ = cv2.findContours(np.pad(free, 1).astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    points, contour, along, whole = [np.zeros((0, 2))], [], [], []
    for number, chain in enumerate(found):
        corners = cv2.approxPolyDP(chain, SIMPLIFIED_M / cell, closed=True).reshape(-1, 2)[:, ::-1]
        corners = (corners - 0.5) * cell  # image rows are x; the padding is one cell, and centres are at halves
        sides = np.roll(corners, -1, axis=0) - corners
        lengths = np.linalg.norm(sides, axis=1)
        starts = np.concatenate([[0.0], np.cumsum(lengths)])
        whole.append(starts[-1])
        for corner, side, length, start in zip(corners, sides, lengths, starts):
            steps = np.arange(max(1, round(length / SPACING_M))) / max(1, round(length / SPACING_M))
            points.append(corner + steps[:, None] * side)
            along.append(start + steps * length)
            contour.append(np.full(len(steps), number))
    if not whole:
        return points[0], np.zeros(0, np.int64), np.zeros(0), np.zeros(0)
    return np.concatenate(points), np.concatenate(contour), np.concatenate(along), np.array(whole)


def _contracted(
    graph: nx.Graph, junctions: set[int]
) -> tuple[list[tuple[int, int, float]], list[tuple[int, int]]]:  # (junction, junction, metres), (junction, end)
    """Remove the vertices of degree 2; return the paths between junctions, and the chains without a second junction.

    A path has its two junctions and its length in metres. A chain has its junction and its end, a vertex of degree 1.
    """
    ways, chains = [], []
    for start in sorted(junctions):
        for step in sorted(graph[start]):
            last, here, length = start, step, graph.edges[start, step]["length"]
            while here not in junctions and graph.degree[here] == 2:
                following = next(v for v in graph[here] if v != last)
                length += graph.edges[here, following]["length"]
                last, here = here, following
            if here not in junctions:
                chains.append((start, here))
            elif start <= here:
                ways.append((start, here, length))
    return ways, chains


def _merged(graph: nx.Graph, junctions: set[int], ways: list[tuple[int, int, float]]) -> dict[int, int]:
    """Return a dict from each junction to the one with the largest clearance in its group.

    A group consists of junctions connected by paths shorter than 0.5 m. ``ways`` are the paths, as from `_contracted`.
    """
    near = nx.Graph()
    near.add_nodes_from(sorted(junctions))
    near.add_edges_from((a, b) for a, b, length in ways if length < MERGED_M)
    leader = {}
    for group in nx.connected_components(near):
        widest = max(group, key=lambda v: (graph.nodes[v]["clearance"], v))
        leader.update(dict.fromkeys(group, widest))
    return leader


def _lonely(free: np.ndarray, origin: np.ndarray, cell: float, radius: float) -> VoronoiGraph:
    """Return a graph with one node, the free cell with the largest clearance; empty if that is at most ``radius``.

    Arguments as in `voronoi_graph`.
    """
    distance = cv2.distanceTransform(np.pad(free, 1).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    best = np.unravel_index(int(np.argmax(distance)), distance.shape)
    clearance = float(distance[best] - 0.5) * cell
    if clearance <= radius:
        return _assembled(np.zeros((0, 2)), np.zeros(0), {}, [])
    return _assembled(np.asarray(origin) + (np.array([best]) + 0.5) * cell, np.array([clearance]), {}, [])


def _assembled(
    nodes: np.ndarray, clearance: np.ndarray, edges: dict[tuple[int, int], float], chains: list[tuple[np.ndarray, int]]
) -> VoronoiGraph:
    pairs = sorted(edges)
    return VoronoiGraph(
        nodes=nodes,
        clearance=clearance,
        edges=np.array(pairs, dtype=np.int64).reshape(-1, 2),
        lengths=np.array([edges[pair] for pair in pairs]),
        chain_ends=np.array([end for end, _ in chains]).reshape(-1, 2),
        chain_nodes=np.array([node for _, node in chains], dtype=np.int64),
    )
