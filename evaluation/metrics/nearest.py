"""Find exact nearest points or discs with a tree of bounding boxes over points sorted along a space-filling curve.

A query far from all points takes 5 to 14 microseconds with scipy's k-d tree, and a half-explored scene has 100,000 such
queries. Here the queries are sorted along the same curve. Each search begins with the nearest point of the previous
query as an upper bound, which excludes most of the tree. The distances do not depend on the order or on the number of
threads.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.evaluation.machine.threads import thread_cap
from activestructure_gym.geometry.curve import curve_order

_LEAF = 8  # points per leaf of the tree
_CHUNK = 8192  # queries per task of a thread
_MAX_DEPTH = 64  # entries of the search stack, one per level of the tree; 2^64 leaves cannot exist


class _Tree(NamedTuple):
    """Hold the arrays of a `PointTree` that the search reads."""

    points: np.ndarray  # [N, 3] metres, sorted along the curve
    normals: np.ndarray  # [N, 3] unit vectors; [0, 3] without discs
    radius: float  # metres, of every disc
    discs: bool  # whether the points are centres of discs
    first_leaf: int  # index of the first leaf among the nodes, also the number of leaves
    boxes: np.ndarray  # [2 first_leaf, 6] lower and upper corners; node 1 is the root, n has children 2 n and 2 n + 1


class PointTree:
    """Search for the nearest of points; with normals, for the nearest of flat discs around the points."""

    def __init__(
        self,
        points: np.ndarray,  # [N, 3] metres
        normals: np.ndarray | None = None,  # [N, 3] unit
        radius: float = 0.0,  # metres, of every disc
    ) -> None:
        points = np.ascontiguousarray(points, np.float64).reshape(-1, 3)
        self.order = curve_order(points)
        self._points = points[self.order]
        self._discs = normals is not None
        self._normals = np.zeros((0, 3)) if normals is None else np.ascontiguousarray(normals, np.float64)[self.order]
        self._radius = float(radius) if self._discs else 0.0
        leaves = max(1, -(-len(points) // _LEAF))
        self._first_leaf = 1 << (leaves - 1).bit_length()
        self._boxes = np.empty((2 * self._first_leaf, 6))
        self._boxes[:, :3], self._boxes[:, 3:] = np.inf, -np.inf
        _build(self._points, self._first_leaf, self._boxes)

    def __len__(self) -> int:
        return len(self._points)

    def query(self, queries: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # [Q] metres, [Q] index
        """Return the distance from each query [Q, 3] to the nearest point (or disc), and the index of that point.

        The distance is inf and the index -1 if there are no points.
        """
        queries = np.ascontiguousarray(queries, np.float64).reshape(-1, 3)
        distance = np.full(len(queries), np.inf)
        index = np.full(len(queries), -1, np.int64)
        if not len(self) or not len(queries):
            return distance, index
        tree = _Tree(self._points, self._normals, self._radius, self._discs, self._first_leaf, self._boxes)
        order = curve_order(queries)
        ordered = queries[order]
        near, which = np.empty(len(queries)), np.empty(len(queries), np.int64)

        def work(first: int) -> None:
            part = slice(first, first + _CHUNK)
            _search(tree, ordered[part], near[part], which[part])

        starts = range(0, len(queries), _CHUNK)
        threads = min(thread_cap(), len(starts))
        if threads <= 1:
            for start in starts:
                work(start)
        else:
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(work, starts))
        distance[order] = np.sqrt(near)
        index[order] = self.order[which]
        return distance, index


@kernel
def _build(points: np.ndarray, first_leaf: int, boxes: np.ndarray) -> None:
    """Extend ``boxes`` to the bounding boxes of the leaves (8 points each) and of the nodes above them."""
    for i in range(len(points)):
        box = boxes[first_leaf + i // 8]
        for axis in range(3):
            box[axis] = min(box[axis], points[i, axis])
            box[3 + axis] = max(box[3 + axis], points[i, axis])
    for node in range(first_leaf - 1, 0, -1):
        for axis in range(3):
            boxes[node, axis] = min(boxes[2 * node, axis], boxes[2 * node + 1, axis])
            boxes[node, 3 + axis] = max(boxes[2 * node, 3 + axis], boxes[2 * node + 1, 3 + axis])


@kernel
def _box_distance(boxes: np.ndarray, node: int, x: float, y: float, z: float, spare: float) -> float:
    """Return the squared distance from (x, y, z) to the box of a node, less ``spare`` metres before squaring."""
    dx = max(max(boxes[node, 0] - x, x - boxes[node, 3]), 0.0)
    dy = max(max(boxes[node, 1] - y, y - boxes[node, 4]), 0.0)
    dz = max(max(boxes[node, 2] - z, z - boxes[node, 5]), 0.0)
    squared = dx * dx + dy * dy + dz * dz
    if spare == 0.0:
        return squared
    left = max(np.sqrt(squared) - spare, 0.0)
    return left * left


@kernel
def _squared(
    points: np.ndarray, normals: np.ndarray, radius: float, discs: bool, i: int, x: float, y: float, z: float
) -> float:
    """Return the squared distance in m^2 from (x, y, z) to point ``i``, or to the disc around it if ``discs``."""
    dx, dy, dz = x - points[i, 0], y - points[i, 1], z - points[i, 2]
    squared = dx * dx + dy * dy + dz * dz
    if not discs:
        return squared
    height = dx * normals[i, 0] + dy * normals[i, 1] + dz * normals[i, 2]
    outside = max(np.sqrt(max(squared - height * height, 0.0)) - radius, 0.0)
    return height * height + outside * outside


@kernel
def _search(
    tree: _Tree,
    queries: np.ndarray,  # [Q, 3] sorted
    near: np.ndarray,  # [Q] out, squared metres
    which: np.ndarray,  # [Q] out, index into points
) -> None:
    """Write the squared distance to the nearest point (or disc) of each query, and the index of this point."""
    points, normals, radius, discs, first_leaf, boxes = tree
    stack = np.empty(64, np.int64)
    below = np.empty(64)
    best_index = 0
    for q in range(len(queries)):
        x, y, z = queries[q, 0], queries[q, 1], queries[q, 2]
        best = _squared(points, normals, radius, discs, best_index, x, y, z)
        stack[0], below[0], depth = 1, _box_distance(boxes, 1, x, y, z, radius), 1
        while depth > 0:
            depth -= 1
            # At equal distances any of the points may be returned, so equal bounds can be skipped.
            if below[depth] >= best:
                continue
            node = stack[depth]
            if node >= first_leaf:
                start = (node - first_leaf) * 8
                for i in range(start, min(start + 8, len(points))):
                    squared = _squared(points, normals, radius, discs, i, x, y, z)
                    if squared < best:
                        best, best_index = squared, i
                continue
            left, right = 2 * node, 2 * node + 1
            to_left = _box_distance(boxes, left, x, y, z, radius)
            to_right = _box_distance(boxes, right, x, y, z, radius)
            if to_left < to_right:
                left, right, to_left, to_right = right, left, to_right, to_left
            stack[depth], below[depth] = left, to_left
            stack[depth + 1], below[depth + 1] = right, to_right
            depth += 2
        near[q], which[q] = best, best_index
