"""Plan a collision-free path: rapidly-exploring random tree (RRT), then shortcuts (paper, Sec. 3.4)."""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.motion.clearance import first_blocked_edge
from activestructure_gym.motion.reachability import HERE, DistanceMap, path_lengths
from activestructure_gym.volume import VoxelVolume
from activestructure_gym.volume.distance_field import segment_above

_STEP = 0.4  # longest edge of the tree, metres (docs/notebook/lab_notes.md)
_GOAL_BIAS = 0.1  # fraction of samples that are the goal (same source)
_SHORTCUTS = 100  # number of random shortcuts tried


@kernel
def _grow(
    field: np.ndarray,  # [X, Y, Z] clearance, metres
    start: np.ndarray,  # [3] voxels
    goal: np.ndarray,  # [3] voxels
    samples: np.ndarray,  # [K, 3] voxels: the tree grows towards one of them in each iteration
    bound: float,  # least clearance, metres
    step: float,  # longest edge, voxels
) -> tuple[np.ndarray, np.ndarray, int]:
    """Grow a tree from the start until a node has a free line to the goal.

    Returns nodes [M, 3] in voxels, the parent of each node [M], and the node with the free line, or -1.
    """
    nodes = np.empty((len(samples) + 1, 3))
    parents = np.empty(len(samples) + 1, np.int64)
    for i in range(3):  # numba needs 3 s more to compile the assignment of a whole row
        nodes[0, i] = start[i]
    parents[0] = -1
    count = 1
    for k in range(len(samples)):
        nearest, shortest = 0, np.inf
        for n in range(count):
            a, b, c = nodes[n, 0] - samples[k, 0], nodes[n, 1] - samples[k, 1], nodes[n, 2] - samples[k, 2]
            squared = a * a + b * b + c * c
            if squared < shortest:
                nearest, shortest = n, squared
        distance = np.sqrt(shortest)
        if distance < 1e-6:
            continue
        share = min(1.0, step / distance)
        for i in range(3):
            nodes[count, i] = nodes[nearest, i] + (samples[k, i] - nodes[nearest, i]) * share
        if not segment_above(field, nodes[nearest], nodes[count], bound, 0.5):
            continue
        parents[count] = nearest
        count += 1
        # The goal is tried from every new node, as in ActiveGAMER. In rooms, most nodes have a free line to it.
        if segment_above(field, nodes[count - 1], goal, bound, 0.5):
            return nodes[:count], parents[:count], count - 1
    return nodes[:count], parents[:count], -1


def plan_path(
    volume: VoxelVolume,
    start: np.ndarray,  # [3] metres, world
    goal: np.ndarray,  # [3] metres, world
    *,
    min_clearance: float,  # metres, kept along every edge (sampled every half voxel)
    rng: np.random.Generator,
    max_iterations: int = 1000,  # largest number of RRT iterations
    distances: DistanceMap | None = None,  # path_lengths(volume, start, ...), if already computed
) -> np.ndarray | None:  # [P, 3] metres, from start to goal; None = no path
    """Return a short path that keeps the clearance: the straight line if it is free, else by RRT and shortcuts.

    A path is found exactly if `DistanceMap.at` is finite, and is never longer than `DistanceMap.path_to`. If the tree
    fails or its path is longer, the grid path is shortened instead. If the start has too little clearance, the first
    edge goes straight to a voxel with enough (`path_lengths`); only this edge has less clearance.
    """
    start, goal = np.asarray(start, dtype=np.float64), np.asarray(goal, dtype=np.float64)
    away = np.linalg.norm(goal - start)
    if away < HERE or volume.segments_free(start, goal, min_clearance=min_clearance)[0]:
        return np.stack([start, goal]) if away > 1e-9 else start[None]
    if distances is None:
        distances = path_lengths(volume, start, min_clearance=min_clearance)
    on_grid = distances.path_to(goal)
    if on_grid is None:
        return None
    root = 0 if volume.clearance_at(start[None])[0] >= min_clearance else 1
    lead, trunk = on_grid[:root], on_grid[root:]
    found = _tree_path(volume, trunk[0], goal, distances.reachable, min_clearance, rng, max_iterations)
    if found is not None:
        found = shorten(volume, found, min_clearance=min_clearance, rng=rng)
    if found is None or _length(found) > _length(trunk):
        found = shorten(volume, trunk, min_clearance=min_clearance, rng=rng)
    path = np.vstack([lead, found])
    return path if first_blocked_edge(volume, path, min_clearance=min_clearance) is None else on_grid


def _tree_path(
    volume: VoxelVolume,
    root: np.ndarray,  # [3] metres
    goal: np.ndarray,  # [3] metres
    reachable: np.ndarray,  # [M, 3] metres, voxel centres to sample from
    min_clearance: float,
    rng: np.random.Generator,
    max_iterations: int,
) -> np.ndarray | None:  # [P, 3] metres
    samples = reachable[rng.integers(len(reachable), size=max_iterations)]
    samples += volume.voxel_size * (rng.random((max_iterations, 3)) - 0.5)
    samples[rng.random(max_iterations) < _GOAL_BIAS] = goal
    from_, to, through = ((p - volume.origin) / volume.voxel_size - 0.5 for p in (root, goal, samples))
    nodes, parents, last = _grow(volume.clearance, from_, to, through, min_clearance, _STEP / volume.voxel_size)
    if last < 0:
        return None
    chain = []
    while last >= 0:
        chain.append(last)
        last = int(parents[last])
    return np.vstack([root, volume.origin + (nodes[chain[::-1]][1:] + 0.5) * volume.voxel_size, goal])


def shorten(
    volume: VoxelVolume,
    path: np.ndarray,  # [P, 3] metres
    *,
    min_clearance: float,  # metres
    rng: np.random.Generator,
    tries: int = _SHORTCUTS,  # number of random shortcuts tried
) -> np.ndarray:  # [Q, 3] metres, the same ends
    """Shorten the path by straight lines that keep the clearance. The result is never longer."""
    draws, path = rng.random((tries, 2)), np.ascontiguousarray(path, dtype=np.float64)
    return _shorten(volume.clearance, path, draws, volume.origin.astype(np.float64), volume.voxel_size, min_clearance)


@kernel
def _shorten(
    field: np.ndarray,  # [X, Y, Z] clearance, metres
    path: np.ndarray,  # [P, 3] metres
    draws: np.ndarray,  # [K, 2] fractions of the path length: both ends of each shortcut, in any order
    origin: np.ndarray,  # [3] metres, lower corner of voxel (0, 0, 0)
    voxel: float,  # metres
    bound: float,  # least clearance, metres
) -> np.ndarray:  # [Q, 3] metres
    first = _skip_vertices(field, path, origin, voxel, bound)
    count = len(first)
    vertices, reached = (
        np.empty((count + len(draws), 3)),
        np.empty(count + len(draws)),
    )  # each shortcut adds at most one vertex
    for n in range(count):
        for i in range(3):
            vertices[n, i] = first[n, i]
    _measure(vertices, count, reached)
    ends, coordinates = np.empty((2, 3)), np.empty((4, 3))
    edges, at = np.empty(2, np.int64), np.empty(2)
    for k in range(len(draws)):
        if count < 3:
            break
        one, other = draws[k, 0] * reached[count - 1], draws[k, 1] * reached[count - 1]
        at[0], at[1] = min(one, other), max(one, other)
        for e in range(2):
            edge = 0
            while edge < count - 2 and reached[edge + 1] <= at[e]:
                edge += 1
            edges[e] = edge
            share = (at[e] - reached[edge]) / (reached[edge + 1] - reached[edge])
            for i in range(3):
                ends[e, i] = vertices[edge, i] + (vertices[edge + 1, i] - vertices[edge, i]) * share
        if edges[0] == edges[1]:
            continue
        # The remaining pieces of the two cut edges get new sample points, so they are checked as well.
        for i in range(3):
            coordinates[0, i] = (vertices[edges[0], i] - origin[i]) / voxel - 0.5
            coordinates[1, i] = (ends[0, i] - origin[i]) / voxel - 0.5
            coordinates[2, i] = (ends[1, i] - origin[i]) / voxel - 0.5
            coordinates[3, i] = (vertices[edges[1] + 1, i] - origin[i]) / voxel - 0.5
        free = True
        for n in range(3):
            free = free and segment_above(field, coordinates[n], coordinates[n + 1], bound, 0.5)
        if not free:
            continue
        # The ends of the shortcut replace all vertices between the two edges.
        gone = edges[1] - edges[0]
        if gone == 1:
            for n in range(count, edges[1] + 1, -1):
                for i in range(3):
                    vertices[n, i] = vertices[n - 1, i]
        else:
            for n in range(edges[1] + 1, count):
                for i in range(3):
                    vertices[n + 2 - gone, i] = vertices[n, i]
        for e in range(2):
            for i in range(3):
                vertices[edges[0] + 1 + e, i] = ends[e, i]
        count += 2 - gone
        _measure(vertices, count, reached)
    return _skip_vertices(field, vertices[:count], origin, voxel, bound)


@kernel
def _measure(vertices: np.ndarray, count: int, reached: np.ndarray) -> None:
    """Write the path length in metres from the first to each of ``count`` vertices [n, 3] into ``reached`` [n]."""
    reached[0] = 0.0
    for n in range(1, count):
        x, y = vertices[n, 0] - vertices[n - 1, 0], vertices[n, 1] - vertices[n - 1, 1]
        z = vertices[n, 2] - vertices[n - 1, 2]
        reached[n] = reached[n - 1] + np.sqrt(x * x + y * y + z * z)


@kernel
def _skip_vertices(
    field: np.ndarray,  # [X, Y, Z] clearance, metres
    path: np.ndarray,  # [P, 3] metres
    origin: np.ndarray,  # [3] metres, lower corner of voxel (0, 0, 0)
    voxel: float,  # metres
    bound: float,  # least clearance, metres
) -> np.ndarray:  # [Q, 3] metres
    """Return the path without unnecessary vertices: each vertex is followed by the last one with a free line to it."""
    coordinates, kept = np.empty((len(path), 3)), np.empty(len(path), np.int64)
    for n in range(len(path)):
        for i in range(3):
            coordinates[n, i] = (path[n, i] - origin[i]) / voxel - 0.5
    kept[0], count, here = 0, 1, 0
    while here < len(path) - 1:
        there = here + 1
        for later in range(len(path) - 1, here + 1, -1):
            if segment_above(field, coordinates[here], coordinates[later], bound, 0.5):
                there = later
                break
        here = there
        kept[count] = here
        count += 1
    result = np.empty((count, 3))
    for n in range(count):
        for i in range(3):
            result[n, i] = path[kept[n], i]
    return result


def _length(path: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
