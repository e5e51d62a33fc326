"""Trace rays against a hierarchy of boxes.

A first hit does not depend on the hierarchy: among hits at the same distance, the face with the lowest number counts.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from activestructure_gym.compiling import kernel
from activestructure_gym.scenes.hierarchy import LEAF_BITS, MOST_WAITING, build_hierarchy
from activestructure_gym.scenes.rays import Hits

# Part of the kernel that calls it; its calls do not count references to arrays, which would be atomic additions.
_OPTIONS: dict[str, Any] = {"_nrt": False, "forceinline": True, "error_model": "numpy"}
_OPTIONS |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
_inlined = njit(**_OPTIONS)
F32, F64, U64 = np.float32, np.float64, np.uint64  # unsigned indices need no test for negative ones
_SMALLEST = F32(1e-30)  # for boxes, components of a direction count as at least this large
# Boxes are tested in float32. Each of three operations rounds by 6e-8 (Ize, Robust BVH ray traversal, JCGT 2013).
_WIDER = F32(1.0 + 1e-6)
BEHIND = 1.0 + 2.0**-20  # factor on the distance to a back when it is compared: 1 micrometre per metre
_NO_FACE = 1 << 31  # above all faces
_LEAF_MASK = (1 << LEAF_BITS) - 1


class _Ray(NamedTuple):
    """Hold a ray as the tests of boxes and triangles need it."""

    x: np.float32  # origin, metres
    y: np.float32
    z: np.float32
    inverse_x: np.float32  # 1 / direction
    inverse_y: np.float32
    inverse_z: np.float32
    near_x: np.uint64  # index in a box of the face that the ray meets first
    near_y: np.uint64
    near_z: np.uint64
    p: np.float64  # origin along the axes u, v and w; w is the direction's largest component
    q: np.float64
    r: np.float64
    axis_u: np.uint64
    axis_v: np.uint64
    axis_w: np.uint64
    shear_u: np.float64  # direction's u / w, v / w and 1 / w
    shear_v: np.float64
    scale: np.float64


class Tracer:
    """Hold the hierarchy of one mesh; several threads may call it at once. Rays are float32 [N, 3], contiguous."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self._hierarchy = build_hierarchy(vertices, faces)
        self.first_hits(*np.ones((2, 1, 3), np.float32))  # compile here, before threads could wait for each other

    def first_hits(self, origins: np.ndarray, directions: np.ndarray, *, fronts: bool = False) -> Hits:
        """Return the first hit of each ray at a distance of at least 0; both sides of a triangle count.

        With ``fronts``, distances are compared in float32, and those of faces seen from behind are multiplied by
        `BEHIND`. Without it, rounding in float64 decides which of two faces in one plane is hit.
        """
        reach = np.full(len(directions), np.inf, np.float32)
        return self._trace(origins, directions, reach, any_hit=False, fronts=fronts)

    def blocked(self, origins: np.ndarray, directions: np.ndarray, reach: np.ndarray) -> np.ndarray:  # [N] bool
        """Return whether a ray hits at a distance from 0 to ``reach`` [N] float32."""
        return self._trace(origins, directions, reach, any_hit=True, fronts=False).face >= 0

    def _trace(self, *rays: np.ndarray, any_hit: bool, fronts: bool) -> Hits:
        # Kernels are compiled for writable arrays.
        origins, directions, reach = (np.require(array, np.float32, ["C", "W"]) for array in rays)
        count = len(directions)
        hits = Hits(np.empty(count, np.float32), np.empty(count, np.int32), *np.empty((2, count), np.float32))
        _trace(self._hierarchy, origins, directions, reach, any_hit, fronts, hits)
        return hits


@kernel
def _trace(hierarchy, origins, directions, reach, any_hit, fronts, hits):
    """Write the first hit of each ray within its reach, or with ``any_hit`` some hit."""
    boxes, children, corners, faces = hierarchy
    distance, face, u, v = hits
    waiting, entries = np.empty(MOST_WAITING, np.int32), np.empty(MOST_WAITING, np.float32)
    one, two = U64(0), U64(1)
    for n in range(len(directions)):
        ray = _prepared(origins, directions, U64(n))
        best, best_face, best_u, best_v = F64(reach[n]), _NO_FACE, 0.0, 0.0
        least, limit = best, F32(best)  # distance as it is compared
        node, height = np.int32(0), 0
        searching = 0.0 < abs(ray.scale) < np.inf  # neither 0 nor infinite in length
        while searching:
            while node >= 0:
                index = U64(node)
                entry, other_entry = _entry(boxes, index, one, ray, limit), _entry(boxes, index, two, ray, limit)
                enters, enters_other = entry < np.inf, other_entry < np.inf
                if enters and enters_other:
                    swap = other_entry < entry
                    node = children[index, two if swap else one]
                    waiting[height] = children[index, one if swap else two]
                    entries[height] = entry if swap else other_entry
                    height += 1
                elif enters:
                    node = children[index, one]
                elif enters_other:
                    node = children[index, two]
                else:
                    break
            if node < 0:
                first = ~node >> LEAF_BITS
                for row in range(first, first + (~node & _LEAF_MASK) + 1):
                    along, of_b, of_c, facing = _meeting(corners, U64(row), ray)
                    here = F64(F32(along if facing > 0.0 else along * BEHIND)) if fronts else along
                    if along >= 0.0 and (here < least or (here == least and faces[row] < best_face)):
                        best, best_face, best_u, best_v = along, int(faces[row]), of_b, of_c
                        least, limit = here, F32(here)
                if any_hit and best_face < _NO_FACE:
                    break
            searching = False
            while height > 0 and not searching:
                height -= 1
                node, searching = waiting[height], entries[height] <= limit * _WIDER
        hit = best_face < _NO_FACE
        distance[n], face[n], u[n], v[n] = best if hit else np.inf, best_face if hit else -1, best_u, best_v


@_inlined
def _prepared(origins, directions, n):
    """Return the `_Ray` of an origin and a direction."""
    x, y, z = directions[n, U64(0)], directions[n, U64(1)], directions[n, U64(2)]
    w = 0 if abs(x) >= max(abs(y), abs(z)) else 1 if abs(y) >= abs(z) else 2
    a, b, c = U64((w + 1) % 3), U64((w + 2) % 3), U64(w)
    longest = F64(directions[n, c])
    inverse_x, inverse_y, inverse_z = _inverse(x), _inverse(y), _inverse(z)
    return _Ray(
        origins[n, U64(0)], origins[n, U64(1)], origins[n, U64(2)], inverse_x, inverse_y, inverse_z,
        U64(0 if inverse_x > 0 else 3), U64(1 if inverse_y > 0 else 4), U64(2 if inverse_z > 0 else 5),
        F64(origins[n, a]), F64(origins[n, b]), F64(origins[n, c]), a, b, c,
        directions[n, a] / longest, directions[n, b] / longest, 1.0 / longest,
    )  # fmt: skip


@_inlined
def _inverse(component):
    """Return 1 / component; where that is infinite, a number so large that 0 times it is 0."""
    return F32(1.0) / (_SMALLEST if abs(component) < _SMALLEST else component)


@_inlined
def _entry(boxes, node, child, ray, limit):
    """Return the distance at which the ray enters a child's box, at least 0; inf if it misses or ``limit`` is nearer.

    Rounding may only let a ray enter a box that it misses.
    """
    begin_x = (boxes[node, child, ray.near_x] - ray.x) * ray.inverse_x
    begin_y = (boxes[node, child, ray.near_y] - ray.y) * ray.inverse_y
    begin_z = (boxes[node, child, ray.near_z] - ray.z) * ray.inverse_z
    end_x = (boxes[node, child, U64(3) - ray.near_x] - ray.x) * ray.inverse_x
    end_y = (boxes[node, child, U64(5) - ray.near_y] - ray.y) * ray.inverse_y
    end_z = (boxes[node, child, U64(7) - ray.near_z] - ray.z) * ray.inverse_z
    begin = max(max(begin_x, begin_y), max(begin_z, F32(0.0)))
    end = min(min(end_x, end_y), min(end_z, limit))
    return begin if begin <= end * _WIDER else F32(np.inf)


@_inlined
def _meeting(corners, row, ray):
    """Return distance, u, v and side where a ray meets a triangle; NaN or a negative distance if it does not.

    The side is positive for the front, from which the vertices are counterclockwise.
    Woop, Benthin and Wald, Watertight ray/triangle intersection, JCGT 2013, in float64. Neighbouring triangles compute
    the same number for their common edge, up to the sign. An edge belongs to both of them.
    """
    u, v, w, three, six = ray.axis_u, ray.axis_v, ray.axis_w, U64(3), U64(6)
    az, bz, cz = corners[row, w] - ray.r, corners[row, w + three] - ray.r, corners[row, w + six] - ray.r
    ax, ay = corners[row, u] - ray.p - ray.shear_u * az, corners[row, v] - ray.q - ray.shear_v * az
    bx, by = corners[row, u + three] - ray.p - ray.shear_u * bz, corners[row, v + three] - ray.q - ray.shear_v * bz
    cx, cy = corners[row, u + six] - ray.p - ray.shear_u * cz, corners[row, v + six] - ray.q - ray.shear_v * cz
    of_a, of_b, of_c = cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax
    if min(of_a, of_b, of_c) < 0.0 < max(of_a, of_b, of_c):
        return -1.0, 0.0, 0.0, 0.0
    total = of_a + of_b + of_c  # 0 if the triangle is seen edge-on
    return (of_a * az + of_b * bz + of_c * cz) * ray.scale / total, of_b / total, of_c / total, total * ray.scale
