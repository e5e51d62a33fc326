"""Compute the compiled loops of plane quality: holes in the grid of a plane, and open sides of its edge."""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.planes.surface_kernels import UNKNOWN


@kernel
def _may_touch(index, other, stack, cell, reach):
    """Return whether the rectangle of grid ``index``, enlarged by a cell, can be within ``reach`` of grid ``other``.

    The result is False only if one of the other grid's three axes separates the two. ``stack`` is a
    `surface.GridStack`.
    """
    grids, lows, shapes = stack.frames, stack.lows, stack.shapes
    for axis in range(3):
        q = 3 + 3 * axis
        u, v, w = grids[other, q], grids[other, q + 1], grids[other, q + 2]
        middle = (
            (grids[index, 0] - grids[other, 0]) * u
            + (grids[index, 1] - grids[other, 1]) * v
            + (grids[index, 2] - grids[other, 2]) * w
        )
        lowest = highest = middle
        for side in range(2):
            m = 3 + 3 * side
            along = (grids[index, m] * u + grids[index, m + 1] * v + grids[index, m + 2] * w) * cell
            near, far = along * (lows[index, side] - 1), along * (lows[index, side] + shapes[index, side] + 1)
            lowest, highest = lowest + min(near, far), highest + max(near, far)
        if axis < 2:
            if highest < lows[other, axis] * cell or lowest > (lows[other, axis] + shapes[other, axis]) * cell:
                return False
        elif lowest > reach or highest < -reach:
            return False
    return True


@kernel
def edge_sides(seen, beside):
    """Find the boundary sides of a grid: sides of seen cells towards cells that are not seen, in four directions.

    ``beside`` [R, C] states what images observed in unseen cells. Returns the number of sides, and row, column and
    direction [M, 3] of the sides towards cells in which nothing was observed.
    """
    rows, columns = seen.shape
    total, sides = 0, 0
    found = np.empty((256, 3), np.int64)
    for r in range(rows):
        for c in range(columns):
            if not seen[r, c]:
                continue
            for k in range(4):
                rr, cc = r + (k == 0) - (k == 1), c + (k == 2) - (k == 3)
                inside = 0 <= rr < rows and 0 <= cc < columns
                if inside and seen[rr, cc]:
                    continue
                sides += 1
                if inside and beside[rr, cc] != UNKNOWN:
                    continue
                if total == len(found):
                    more = np.empty((2 * total, 3), np.int64)
                    for i in range(total):  # the assignment of a slice takes five seconds to compile
                        for m in range(3):
                            more[i, m] = found[i, m]
                    found = more
                found[total, 0], found[total, 1], found[total, 2] = r, c, k
                total += 1
    return sides, found[:total].copy()


@kernel
def open_sides(edges, ends, near, stack, cell, reach, step):
    """Return the boundary sides of all planes that no other plane closes.

    ``edges`` [M, 3] are row, column and direction of the sides; the sides of plane k end at row ``ends[k]``. A side is
    closed if another plane passes within ``reach`` metres of the centre of the cell beyond it. ``near`` holds the seen
    cells dilated by two cells, flat over all grids of ``stack`` (a `surface.GridStack`). Returns for every open side
    the world point ``step`` metres outwards from the cell's centre [K, 3], and the index of its plane [K].
    """
    grids, lows, shapes, starts = stack
    total = 0
    probes, owner = np.empty((len(edges), 3)), np.empty(len(edges), np.int64)
    others = np.empty(len(grids), np.int64)
    for index in range(len(grids)):
        first = ends[index - 1] if index > 0 else 0
        if first == ends[index]:
            continue
        g = grids[index]
        close = 0
        for j in range(len(grids)):
            if j != index and _may_touch(index, j, stack, cell, reach):
                others[close] = j
                close += 1
        for edge in range(first, ends[index]):
            r, c, k = edges[edge, 0], edges[edge, 1], edges[edge, 2]
            dr = 1 if k == 0 else -1 if k == 1 else 0
            dc = 1 if k == 2 else -1 if k == 3 else 0
            a = (r + dr + lows[index, 0] + 0.5) * cell
            b = (c + dc + lows[index, 1] + 0.5) * cell
            px = g[0] + a * g[3] + b * g[6]
            py = g[1] + a * g[4] + b * g[7]
            pz = g[2] + a * g[5] + b * g[8]
            closed = False
            for near_by in range(close):
                j = others[near_by]
                dx, dy, dz = px - grids[j, 0], py - grids[j, 1], pz - grids[j, 2]
                if abs(dx * grids[j, 9] + dy * grids[j, 10] + dz * grids[j, 11]) > reach:
                    continue
                jr = int(np.floor((dx * grids[j, 3] + dy * grids[j, 4] + dz * grids[j, 5]) / cell)) - lows[j, 0]
                jc = int(np.floor((dx * grids[j, 6] + dy * grids[j, 7] + dz * grids[j, 8]) / cell)) - lows[j, 1]
                if 0 <= jr < shapes[j, 0] and 0 <= jc < shapes[j, 1]:
                    if near[starts[j] + jr * shapes[j, 1] + jc]:
                        closed = True
                        break
            if closed:
                continue
            a = (r + dr * (step / cell) + lows[index, 0] + 0.5) * cell
            b = (c + dc * (step / cell) + lows[index, 1] + 0.5) * cell
            for m in range(3):
                probes[total, m] = g[m] + (a * g[3 + m] + b * g[6 + m])
            owner[total] = index
            total += 1
    return probes[:total], owner[:total]


@kernel
def tile_holes(labels, depth, count, min_radius, tile, min_cells):
    """Divide holes into tiles, and return the cell nearest to the mean of each tile's cells.

    ``labels`` [R, C] is the hole of every cell, 0 = none, for ``count - 1`` holes. ``depth`` [R, C] is the distance to
    the edge of the hole in cells. Holes with a largest distance below ``min_radius`` and tiles of fewer than
    ``min_cells`` cells are left out. Tiles start at the corner of the hole, so the result is independent of the origin
    of the grid. Returns the cells [D, 2] and the number of cells of each tile [D], sorted by hole, then by tile.
    """
    rows, columns = labels.shape
    widest = np.zeros(count)
    box = np.empty((count, 4), np.int64)  # first and last row, first and last column
    box[:, 0], box[:, 1], box[:, 2], box[:, 3] = rows, -1, columns, -1
    for r in range(rows):
        for c in range(columns):
            n = labels[r, c]
            if n > 0:
                widest[n] = max(widest[n], depth[r, c])
                box[n, 0], box[n, 1] = min(box[n, 0], r), max(box[n, 1], r)
                box[n, 2], box[n, 3] = min(box[n, 2], c), max(box[n, 3], c)
    starts, across = np.full(count, -1), np.zeros(count, np.int64)
    total = 0
    for n in range(1, count):
        if widest[n] >= min_radius:
            starts[n], across[n] = total, (box[n, 3] - box[n, 2]) // tile + 1
            total += across[n] * ((box[n, 1] - box[n, 0]) // tile + 1)
    sums = np.zeros((total, 3))  # number of cells, sum of rows, sum of columns
    best, chosen = np.full(total, np.inf), np.empty((total, 2), np.int64)
    for turn in range(2):
        for r in range(rows):
            for c in range(columns):
                n = labels[r, c]
                if n == 0 or starts[n] < 0:
                    continue
                t = starts[n] + (r - box[n, 0]) // tile * across[n] + (c - box[n, 2]) // tile
                if turn == 0:
                    sums[t, 0] += 1.0
                    sums[t, 1] += r
                    sums[t, 2] += c
                else:
                    # The distance is rounded to six digits, so that the first of equally near cells is selected in
                    # spite of rounding errors.
                    away = np.rint(((r - sums[t, 1] / sums[t, 0]) ** 2 + (c - sums[t, 2] / sums[t, 0]) ** 2) * 1e6)
                    if away < best[t]:
                        best[t] = away
                        chosen[t, 0], chosen[t, 1] = r, c
    large = sums[:, 0] >= max(min_cells, 1)  # a tile of the hole's rectangle may contain no cell of the hole
    return chosen[large], sums[large, 0].astype(np.int64)
