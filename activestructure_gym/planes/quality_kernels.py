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
def survey(seen, hits, beside, disc, dense):
    """Close the seen cells [R, C] of a grid, fill their holes, and measure the result.

    Closing dilates by the structuring element ``disc`` [D, D], then erodes by it. ``hits`` [R, C] is the number of
    pixels in each cell, and ``beside`` [R, C] what images observed in unseen cells. Returns

    - the mask of the closed and filled cells [R, C], and their number;
    - the first row, first column, number of rows and number of columns of the seen cells [4];
    - the number of cells with their centre in the convex hull of the closed cells;
    - the number of boundary sides, and the sides beyond which nothing was observed [M, 3], see `_edge_sides`;
    - per seen cell [S], row by row, ``hits / dense``, at most 1.
    """
    mask, box = np.zeros(seen.shape, np.uint8), _box(seen)
    top, left, height, width = box
    ratios = np.empty(height * width)
    if not height:
        return mask, 0, box, 0, 0, np.empty((0, 3), np.int64), ratios
    reach = len(disc) // 2
    pad = reach + 1
    across = width + 2 * pad  # cells of a padded row
    size = (height + 2 * pad) * across
    cells, wide, closed = np.zeros(size, np.uint8), np.zeros(size, np.uint8), np.ones(size, np.uint8)
    count = 0
    for r in range(height):
        for c in range(width):
            if seen[top + r, left + c]:
                cells[(r + pad) * across + c + pad] = 1
                ratios[count] = min(hits[top + r, left + c] / dense, 1.0)
                count += 1
    first, last = pad * across, size - pad * across  # the rows of the rectangle; shifts may reach one row of padding
    # A row of the disc is a run of cells with its middle in the middle column. ``line`` holds the cells dilated, then
    # eroded, by the run of a half width, which grows by one cell on each side at a time.
    line = cells.copy()
    for half in range(reach + 1):
        if half:
            target, left_of, right_of = line[first:last], cells[first - half : last - half], cells[first + half :]
            for q in range(len(target)):
                target[q] |= left_of[q] | right_of[q]
        for a in range(len(disc)):
            if disc[a].sum() == 2 * half + 1:
                shift = (a - reach) * across
                target, source = wide[first + shift : last + shift], line[first:last]
                for q in range(len(target)):
                    target[q] |= source[q]
    line[:] = wide
    for half in range(reach + 1):
        if half:
            low, high = half, size - half
            target, left_of, right_of = line[low:high], wide[low - half : high - half], wide[low + half :]
            for q in range(len(target)):
                target[q] &= left_of[q] & right_of[q]
        for a in range(len(disc)):
            if disc[a].sum() == 2 * half + 1:
                shift = (a - reach) * across
                target, source = closed[first:last], line[first + shift : last + shift]
                for q in range(len(target)):
                    target[q] &= source[q]
    # Cells that are reached from the padding in four directions are outside: a diagonal row of cells encloses a hole.
    for q in range(size):
        if q < first or q >= last:
            closed[q] = 2
    for q in range(first, last, across):
        for c in range(pad):
            closed[q + c] = closed[q + across - 1 - c] = 2
    stack, waiting = np.empty(size, np.int64), 0
    for q in range(first, last):
        beyond = closed[q - 1] == 2 or closed[q + 1] == 2 or closed[q - across] == 2 or closed[q + across] == 2
        if closed[q] == 0 and beyond:
            closed[q] = 2
            stack[waiting] = q
            waiting += 1
            while waiting:
                waiting -= 1
                here = stack[waiting]
                for shift in (-across, -1, 1, across):
                    if closed[here + shift] == 0:
                        closed[here + shift] = 2
                        stack[waiting] = here + shift
                        waiting += 1
    total = 0
    ends = np.empty((height, 3), np.int64)  # row, first and last column of the closed cells of each row with some
    kept = 0
    for r in range(height):
        begin, end = -1, -1
        for c in range(width):
            if closed[(r + pad) * across + c + pad] != 2:
                mask[top + r, left + c] = 1
                total += 1
                begin, end = c if begin < 0 else begin, c
        if begin >= 0:
            ends[kept, 0], ends[kept, 1], ends[kept, 2] = r, begin, end
            kept += 1
    sides, open_ = _edge_sides(mask, beside, box)
    return mask, total, box, _hull_cells(ends[:kept]), sides, open_, ratios[:count]


@kernel
def _box(seen):
    """Return first row, first column, number of rows and number of columns of the cells [R, C] that are not 0."""
    rows, columns = seen.shape
    box = np.zeros(4, np.int64)
    top, bottom, left, right = rows, -1, columns, -1
    for r in range(rows):
        some = np.uint8(0)
        for c in range(columns):
            some |= seen[r, c]
        if some:
            top, bottom = min(top, r), r
            c = 0
            while not seen[r, c]:
                c += 1
            left = min(left, c)
            c = columns - 1
            while not seen[r, c]:
                c -= 1
            right = max(right, c)
    if bottom >= 0:
        box[0], box[1], box[2], box[3] = top, left, bottom - top + 1, right - left + 1
    return box


@kernel
def _hull_cells(ends):
    """Return the number of cells with their centre in the convex hull of the given cells.

    ``ends`` [N, 3] are row, first and last column of the cells in each row, for increasing rows. By Pick's theorem the
    number is area + half of the cells on the border + 1.
    """
    chain = np.empty((2 * len(ends), 2), np.int64)
    count = 0
    for side in range(2):  # down along the first columns, then up along the last ones
        start = count
        for n in range(len(ends)):
            k = n if side == 0 else len(ends) - 1 - n
            row, column = ends[k, 0], ends[k, 1 + side]
            while count - start > 1:
                a, b = chain[count - 2], chain[count - 1]
                if (b[0] - a[0]) * (column - a[1]) - (b[1] - a[1]) * (row - a[0]) > 0:
                    break
                count -= 1
            chain[count, 0], chain[count, 1] = row, column
            count += 1
    doubled_area, border = 0, 0
    for n in range(count):
        m = n + 1 if n + 1 < count else 0
        rows, columns = chain[m, 0] - chain[n, 0], chain[m, 1] - chain[n, 1]
        doubled_area += chain[n, 0] * columns - chain[n, 1] * rows
        a, b = abs(rows), abs(columns)
        while b:  # greatest common divisor: cells on this side of the border
            a, b = b, a % b
        border += a
    return (abs(doubled_area) + border) // 2 + 1


@kernel
def _edge_sides(seen, beside, box):
    """Find the boundary sides of a grid: sides of seen cells towards cells that are not seen, in four directions.

    ``beside`` [R, C] states what images observed in unseen cells, and ``box`` is the rectangle of the seen cells, see
    `_box`. Returns the number of sides, and row, column and direction [M, 3] of the sides towards cells in which
    nothing was observed.
    """
    rows, columns = seen.shape
    top, left, height, width = box
    total, sides = 0, 0
    found = np.empty((256, 3), np.int64)
    for r in range(top, top + height):
        for c in range(left, left + width):
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
