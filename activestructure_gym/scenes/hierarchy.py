"""Build a bounding volume hierarchy of triangles: binned surface area heuristic.

Wald, On fast construction of SAH-based bounding volume hierarchies, IEEE Symposium on Interactive Ray Tracing 2007.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel

_BINS = 16
_LARGEST_LEAF = 8  # triangles; `LEAF_BITS` hold the number
LEAF_BITS = 3
_BALANCED_FROM = 40  # depth below which a node is cut into equal halves, so that `MOST_WAITING` suffices
MOST_WAITING = _BALANCED_FROM + 32  # nodes that wait on a traversal's stack: one per level
_STEP_COST = 1.0  # cost of entering a node, in triangle tests


class Hierarchy(NamedTuple):
    """Hold a binary hierarchy. Node 0 is the root.

    A child is a node (number of at least 0) or a leaf. A leaf is written ``~(first << LEAF_BITS | count - 1)`` and
    holds the rows ``first`` to ``first + count`` of ``corners``.
    """

    boxes: np.ndarray  # [M, 2, 6] float32: lower and upper corner of each child, in metres
    children: np.ndarray  # [M, 2] int32
    corners: np.ndarray  # [F, 9] float32: the vertices of each triangle, in the order of the leaves
    faces: np.ndarray  # [F] int32: the face of each row of ``corners``


def build_hierarchy(vertices: np.ndarray, faces: np.ndarray) -> Hierarchy:
    """Return the hierarchy of a mesh: ``vertices`` [V, 3] float32 and ``faces`` [F, 3] int32."""
    corners = np.require(vertices, np.float32, ["C", "W"])[faces].reshape(-1, 9)
    boxes, children, order = _build(corners)
    return Hierarchy(boxes, children, corners[order], order)


@kernel
def _build(corners):
    """Return boxes and children of the nodes, and the order of the triangles.

    The first child of the root is the whole mesh and its second one is empty, so that a mesh may be a single leaf.
    """
    count = len(corners)
    bounds, centers = np.empty((count, 6), np.float32), np.empty((count, 3), np.float32)
    order = np.arange(count).astype(np.int32)
    for n in range(count):
        for axis in range(3):
            a, b, c = corners[n, axis], corners[n, axis + 3], corners[n, axis + 6]
            bounds[n, axis], bounds[n, axis + 3] = min(a, b, c), max(a, b, c)
            centers[n, axis] = np.float32(0.5) * (bounds[n, axis] + bounds[n, axis + 3])
    boxes, children = np.empty((count + 1, 2, 6), np.float32), np.zeros((count + 1, 2), np.int32)
    boxes[0, :, :3], boxes[0, :, 3:] = np.inf, -np.inf  # no ray hits an empty box
    bins, counts, right = np.empty((_BINS, 6), np.float32), np.empty(_BINS, np.int64), np.empty(_BINS)
    waiting = np.zeros((MOST_WAITING, 5), np.int64)  # first, last (exclusive), parent, which child, depth
    waiting[0, 1] = count
    nodes, height = 1, min(count, 1)
    while height > 0:
        height -= 1
        first, last, parent, which, depth = waiting[height]
        size, box = last - first, boxes[parent, which]
        _enclose(bounds, order, first, last, box)
        middle, cost = first, np.inf
        if size > 1 and depth < _BALANCED_FROM:
            axis, place, low, scale, cost = _best_cut(bounds, centers, order, first, last, bins, counts, right)
            if axis >= 0:
                middle = _part(centers, order, first, last, axis, place, low, scale)
        if size <= _LARGEST_LEAF and size * _area(box) <= cost + _STEP_COST * _area(box):
            children[parent, which] = ~(first << LEAF_BITS | (size - 1))
            continue
        if middle == first or middle == last:
            middle = (first + last) // 2
        children[parent, which] = nodes
        for child in range(2):
            begin, end = (first, middle) if child == 0 else (middle, last)
            waiting[height, 0], waiting[height, 1], waiting[height, 2] = begin, end, nodes
            waiting[height, 3], waiting[height, 4] = child, depth + 1
            height += 1
        nodes += 1
    return boxes[:nodes].copy(), children[:nodes].copy(), order


@kernel
def _best_cut(bounds, centers, order, first, last, bins, counts, right):
    """Return axis, last bin on the left, lower end and bins per metre of the cheapest cut, and its cost; axis -1: none.

    The cost is the sum of area times number of triangles of both sides.
    """
    best = (-1, 0, 0.0, 0.0, np.inf)
    box = np.empty(6, np.float32)
    for axis in range(3):
        low, high = np.inf, -np.inf
        for n in range(first, last):
            center = float(centers[order[n], axis])
            low, high = min(low, center), max(high, center)
        scale = _BINS / (high - low)
        if not scale < np.inf:  # all centres are equal
            continue
        bins[:, :3], bins[:, 3:], counts[:] = np.inf, -np.inf, 0
        for n in range(first, last):
            place = _bin(centers[order[n], axis], low, scale)
            counts[place] += 1
            _widen(bins[place], bounds[order[n]])
        box[:3], box[3:], total = np.inf, -np.inf, 0
        for place in range(_BINS - 1, 0, -1):
            _widen(box, bins[place])
            total += counts[place]
            right[place] = total * _area(box) if total else 0.0
        box[:3], box[3:], total = np.inf, -np.inf, 0
        for place in range(_BINS - 1):
            _widen(box, bins[place])
            total += counts[place]
            cost = total * _area(box) + right[place + 1] if 0 < total < last - first else np.inf
            if cost < best[4]:
                best = (axis, place, low, scale, cost)
    return best


@kernel
def _bin(center, low, scale):
    return min(int((center - low) * scale), _BINS - 1)


@kernel
def _part(centers, order, first, last, axis, place, low, scale):
    """Move the triangles of the left bins to the front; return the index of the first one on the right."""
    left, right = first, last - 1
    while left <= right:
        if _bin(centers[order[left], axis], low, scale) <= place:
            left += 1
        else:
            order[left], order[right] = order[right], order[left]
            right -= 1
    return left


@kernel
def _enclose(bounds, order, first, last, box):
    """Write the box around some triangles."""
    box[:3], box[3:] = np.inf, -np.inf
    for n in range(first, last):
        _widen(box, bounds[order[n]])


@kernel
def _widen(box, other):
    for axis in range(3):
        box[axis] = min(box[axis], other[axis])
        box[axis + 3] = max(box[axis + 3], other[axis + 3])


@kernel
def _area(box):
    """Return half the surface of a box."""
    x, y, z = box[3] - box[0], box[4] - box[1], box[5] - box[2]
    return x * y + y * z + z * x
