"""A collision-free path: rapidly-exploring random tree on the distance field, then shortcuts (paper, Sec. 3.4)."""

from __future__ import annotations

from bisect import bisect_right

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.motion.clearance import first_blocked_edge
from activestructure_gym.motion.reachability import HERE, DistanceMap, path_lengths
from activestructure_gym.volume import VoxelVolume
from activestructure_gym.volume.distance_field import segment_above

_STEP = 0.4  # metres: longest edge of the tree (docs/notebook/groundwork.md, "Volume and paths")
_GOAL_BIAS = 0.1  # share of samples that are the goal itself (the same)
_SHORTCUTS = 100  # random pairs tried when smoothing


@kernel
def _grow(
    field: np.ndarray,  # clearance, metres
    start: np.ndarray,  # [3] voxels
    goal: np.ndarray,  # [3] voxels
    samples: np.ndarray,  # [K, 3] voxels: where each iteration grows to
    bound: float,  # metres
    step: float,  # voxels
) -> tuple[np.ndarray, np.ndarray, int]:  # (nodes [M, 3], parents [M], index of the node that sees the goal or -1)
    nodes = np.empty((len(samples) + 1, 3))
    parents = np.empty(len(samples) + 1, np.int64)
    for i in range(3):  # numba takes 3 s to compile the assignment of a row, for the text of an error
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
        # The goal is tried from every new node: in rooms most of them see it (as ActiveGAMER does).
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
    max_iterations: int = 1000,
    distances: DistanceMap | None = None,  # path_lengths(volume, start, ...) where it is known already
) -> np.ndarray | None:  # [P, 3] metres, start and goal included; None = there is no way
    """A short path that keeps the clearance: the straight line if it is free, else RRT and shortcuts.

    It succeeds exactly where `DistanceMap.at` is finite, and is never longer than `DistanceMap.path_to`: if the tree
    does not find the goal in time, or wandered, that shortest path on the grid is taken and shortened the same way.
    A start in too tight a place first moves straight out of it (`path_lengths`): the only edge with less clearance.
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
    root: np.ndarray,
    goal: np.ndarray,
    reachable: np.ndarray,  # [M, 3] voxel centres to draw from
    min_clearance: float,
    rng: np.random.Generator,
    max_iterations: int,
) -> np.ndarray | None:
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
    min_clearance: float,
    rng: np.random.Generator,
    tries: int = _SHORTCUTS,
) -> np.ndarray:  # [Q, 3] metres, the same ends
    """Cut corners wherever the straight line keeps the clearance. Never longer than before."""
    path = _skip_vertices(volume, path, min_clearance)
    reached = _reached(path)
    for first, second in rng.random((tries, 2)).tolist():
        if len(path) < 3:
            break
        a, b = sorted((first * reached[-1], second * reached[-1]))
        i, j = (min(bisect_right(reached, s) - 1, len(path) - 2) for s in (a, b))
        if i == j:
            continue
        p, q = (
            path[n] + (path[n + 1] - path[n]) * ((s - reached[n]) / (reached[n + 1] - reached[n]))
            for n, s in ((i, a), (j, b))
        )
        # The pieces of old edges that stay are sampled anew: other sample points, so they are checked as well.
        if volume.segments_free(
            np.stack([path[i], p, q]), np.stack([p, q, path[j + 1]]), min_clearance=min_clearance
        ).all():
            path = np.vstack([path[: i + 1], p, q, path[j + 1 :]])
            reached = _reached(path)
    return _skip_vertices(volume, path, min_clearance)


def _reached(path: np.ndarray) -> list[float]:
    """Metres from the start to every vertex."""
    return [0.0, *np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)).tolist()]


def _length(path: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def _skip_vertices(volume: VoxelVolume, path: np.ndarray, min_clearance: float) -> np.ndarray:
    """The path without vertices it can skip: from each that is kept straight to the last one in sight."""
    kept, here = [0], 0
    while here < len(path) - 1:
        later = np.arange(here + 2, len(path))
        if len(later):
            later = later[volume.segments_free(path[here], path[later], min_clearance=min_clearance)]
        here = int(later[-1]) if len(later) else here + 1
        kept.append(here)
    return path[kept]
