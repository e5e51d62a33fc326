"""Compiled loops between an image and the tangent grids of planes.

A tangent grid is passed as twelve numbers in the world: its origin, its two axes and its normal. Cell (r, c) of a
grid covers ``[r, r + 1) x [c, c + 1)`` cells along the axes, seen from the origin.
"""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.planes.detection_kernels import MOMENTS, add_point

UNKNOWN, OPEN, COVERED = 0, 1, 2


@kernel
def _lift(u, v, depth, lens, rotation, translation):
    """World point of the centre of pixel (u, v); ``lens`` is fx, fy, cx, cy."""
    z = np.float64(depth)
    x, y = (u + 0.5 - lens[2]) / lens[0] * z, (v + 0.5 - lens[3]) / lens[1] * z
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + translation[0],
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + translation[1],
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + translation[2],
    )


@kernel
def _cell_of(px, py, pz, grid, cell):
    """Row and column of a world point in a tangent grid."""
    dx, dy, dz = px - grid[0], py - grid[1], pz - grid[2]
    row = int(np.floor((dx * grid[3] + dy * grid[4] + dz * grid[5]) / cell))
    column = int(np.floor((dx * grid[6] + dy * grid[7] + dz * grid[8]) / cell))
    return row, column


@kernel
def image_sums(depth, labels, table, lens, rotation, translation, grids, anchors, cell):
    """One pass over the pixels: extent of every node in its grid, and its new point moments.

    ``table`` [S] maps a label to a row (or -1) of ``grids`` [T, 12] and ``anchors`` [T, 3], about which the moments
    are taken.
    Returns extents [T, 4] (first row, first column, last row, last column) and moments [T, 10].
    """
    count = len(grids)
    extents = np.empty((count, 4), np.int64)
    extents[:, :2] = 1 << 40
    extents[:, 2:] = -(1 << 40)
    moments = np.zeros((count, MOMENTS))
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            label = labels[v, u]
            if label < 0:
                continue
            t = table[label]
            if t < 0:
                continue
            px, py, pz = _lift(u, v, depth[v, u], lens, rotation, translation)
            add_point(moments[t], px - anchors[t, 0], py - anchors[t, 1], pz - anchors[t, 2])
            r, c = _cell_of(px, py, pz, grids[t], cell)
            extents[t, 0] = min(extents[t, 0], r)
            extents[t, 1] = min(extents[t, 1], c)
            extents[t, 2] = max(extents[t, 2], r)
            extents[t, 3] = max(extents[t, 3], c)
    return extents, moments


@kernel
def count_hits(depth, labels, table, lens, rotation, translation, grids, cell, extents, starts, hits):
    """Pixels per cell, written to the flat ``hits``; node t owns ``hits[starts[t]:starts[t + 1]]``, row-major."""
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            label = labels[v, u]
            if label < 0:
                continue
            t = table[label]
            if t < 0:
                continue
            px, py, pz = _lift(u, v, depth[v, u], lens, rotation, translation)
            r, c = _cell_of(px, py, pz, grids[t], cell)
            r -= extents[t, 0]
            c -= extents[t, 1]
            if 0 <= r <= extents[t, 2] - extents[t, 0] and 0 <= c <= extents[t, 3] - extents[t, 1]:
                hits[starts[t] + r * (extents[t, 3] - extents[t, 1] + 1) + c] += 1


@kernel
def look_up_cells(
    depth, labels, table, lens, rotation, translation, grids, cell, extents, starts, seen, beside, reach, planes, facing
):
    """Project every cell's centre into the image: does the image show this plane there, or what else?

    Looking cells up in the image (not pixels in the grid) makes a cell seen whatever the density of pixels on it, so
    that a distant surface has no false holes. ``seen`` is 0 or 1. ``beside`` says why a cell is not seen: OPEN = the
    view goes through the plane by more than ``reach`` metres, COVERED = something else lies within ``reach`` of it.

    In a corner noise gives pixels of one wall to the other, and at a slant such a pixel points far beyond the corner.
    So a cell next to another segment's pixels is also COVERED when it lies behind that segment's plane (``planes``
    [S, 4] world) and the segment stands on this plane's visible side (``facing`` [T, S]; around a convex edge neither
    plane hides the other).
    """
    height, width = depth.shape
    for t in range(len(grids)):
        g = grids[t]
        # Height of the camera above the plane; the normal points to the side the plane is seen from.
        camera_height = (
            (translation[0] - g[0]) * g[9] + (translation[1] - g[1]) * g[10] + (translation[2] - g[2]) * g[11]
        )
        index = starts[t]
        for r in range(extents[t, 0], extents[t, 2] + 1):
            a = (r + 0.5) * cell
            for c in range(extents[t, 1], extents[t, 3] + 1):
                b = (c + 0.5) * cell
                px = g[0] + a * g[3] + b * g[6] - translation[0]
                py = g[1] + a * g[4] + b * g[7] - translation[1]
                pz = g[2] + a * g[5] + b * g[8] - translation[2]
                z = rotation[0, 2] * px + rotation[1, 2] * py + rotation[2, 2] * pz
                if z > 0.05:
                    x = rotation[0, 0] * px + rotation[1, 0] * py + rotation[2, 0] * pz
                    y = rotation[0, 1] * px + rotation[1, 1] * py + rotation[2, 1] * pz
                    fu = x / z * lens[0] + lens[2]
                    fv = y / z * lens[1] + lens[3]
                    if 0.0 <= fu < width and 0.0 <= fv < height:
                        u, v = int(fu), int(fv)
                        label = labels[v, u]
                        if label >= 0 and table[label] == t:
                            behind = False
                            for vv in range(max(v - 1, 0), min(v + 2, height)):
                                for uu in range(max(u - 1, 0), min(u + 2, width)):
                                    other = labels[vv, uu]
                                    if other >= 0 and facing[t, other]:
                                        q = planes[other]
                                        if (
                                            q[0] * (px + translation[0])
                                            + q[1] * (py + translation[1])
                                            + q[2] * (pz + translation[2])
                                            + q[3]
                                            < -0.2 * cell
                                        ):
                                            behind = True
                            if behind:
                                beside[index] = COVERED
                            else:
                                seen[index] = 1
                        elif depth[v, u] > 0.0:
                            above = camera_height * (1.0 - np.float64(depth[v, u]) / z)
                            if above < -reach:
                                beside[index] = OPEN
                            elif above <= reach:
                                beside[index] = COVERED
                index += 1


@kernel
def qualifying(planes, normal, offset, centroid, limits):
    """Which planes [N, 7] a segment may continue: the larger of the two distances, the index, 1 = too far apart [M, 3].

    Planes are normal, offset and centroid, ``limits`` those of the coplanar and the near mode of
    `matching.MatchingConfig`. Normals face the viewer, so the sign counts: the other face of a thin wall is another
    plane. What is too far apart must touch.
    """
    flat_cosine, flat_distance, lever, flat_reach, near_cosine, near_distance, near_reach = limits
    found, total = np.empty((len(planes), 3)), 0
    for n in range(len(planes)):
        p = planes[n]
        cosine = p[0] * normal[0] + p[1] * normal[1] + p[2] * normal[2]
        if not (cosine > flat_cosine or cosine > near_cosine):
            continue
        to_node = abs(p[0] * centroid[0] + p[1] * centroid[1] + p[2] * centroid[2] + p[3])
        to_segment = abs(p[4] * normal[0] + p[5] * normal[1] + p[6] * normal[2] + offset)
        reach = np.sqrt((p[4] - centroid[0]) ** 2 + (p[5] - centroid[1]) ** 2 + (p[6] - centroid[2]) ** 2)
        near = cosine > near_cosine and to_node < near_distance and reach < near_reach
        flat = cosine > flat_cosine and to_node < flat_distance and to_segment < flat_distance + lever * reach
        if near or flat:
            found[total, 0], found[total, 1] = max(to_node, to_segment), n
            found[total, 2] = 0.0 if near or reach <= flat_reach else 1.0
            total += 1
    return found[:total]


@kernel
def depth_gaps(points, eye, normal, offset, grid, low, seen, cell):
    """How far the points [P, 3] lie from a plane along their rays from ``eye``, times the ray's slant: metres [M].

    Only of rays that meet the plane in front of the eye, in a seen cell of its grid. Seen at a slant a plane's own
    noise moves the meeting point along the ray, hence the slant; 0.2 = 78 degrees from the normal.
    """
    gaps, total = np.empty(len(points)), 0
    height = eye[0] * normal[0] + eye[1] * normal[1] + eye[2] * normal[2] + offset
    for n in range(len(points)):
        x, y, z = points[n, 0] - eye[0], points[n, 1] - eye[1], points[n, 2] - eye[2]
        facing = x * normal[0] + y * normal[1] + z * normal[2]
        along = -height / facing  # 1 where the plane meets the ray at the point's own depth
        if not 0.0 < along < np.inf:
            continue
        r, c = _cell_of(eye[0] + along * x, eye[1] + along * y, eye[2] + along * z, grid, cell)
        r, c = r - low[0], c - low[1]
        if 0 <= r < seen.shape[0] and 0 <= c < seen.shape[1] and seen[r, c]:
            length = np.sqrt(x * x + y * y + z * z)
            slant = min(max(abs(facing) / max(length, 1e-9), 0.2), 1.0)
            gaps[total] = abs(along - 1.0) * length * slant
            total += 1
    return gaps[:total]


@kernel
def near_seen(points, grid, low, seen, cell, disc):
    """Whether the points' feet [P, 3] on a grid's plane lie on seen cells, or a ``disc`` [D, D] of cells from one."""
    near, reach = np.zeros(len(points), np.bool_), len(disc) // 2
    for n in range(len(points)):
        r, c = _cell_of(points[n, 0], points[n, 1], points[n, 2], grid, cell)
        r, c = r - low[0] - reach, c - low[1] - reach
        for a in range(max(-r, 0), min(len(disc), seen.shape[0] - r)):
            for b in range(max(-c, 0), min(len(disc), seen.shape[1] - c)):
                if disc[a, b] and seen[r + a, c + b]:
                    near[n] = True
    return near


@kernel
def ask_cells(grid, cell, low, other, other_cell, other_low, asked, answers):
    """What the arrays of another grid hold at the centres of a rectangle of cells, from ``low`` on; 0 beyond it."""
    shown, denied, hits, beside = asked
    for r in range(answers[0].shape[0]):
        a = (low[0] + r + 0.5) * cell
        for c in range(answers[0].shape[1]):
            b = (low[1] + c + 0.5) * cell
            px, py = grid[0] + (a * grid[3] + b * grid[6]), grid[1] + (a * grid[4] + b * grid[7])
            i, j = _cell_of(px, py, grid[2] + (a * grid[5] + b * grid[8]), other, other_cell)
            i, j = i - other_low[0], j - other_low[1]
            if 0 <= i < shown.shape[0] and 0 <= j < shown.shape[1]:
                answers[0][r, c], answers[1][r, c] = shown[i, j], denied[i, j]
                answers[2][r, c], answers[3][r, c] = hits[i, j], beside[i, j]


@kernel
def join(shown, denied, hits, beside, patch_shown, patch_denied, patch_hits, patch_beside, row, column, seen):
    """Add what one image showed to the arrays of a grid, from (row, column) on; see `surface.SurfaceGrid`.

    Votes: where two planes meet, noise gives a pixel to the wrong one now and then, and without a vote every plane
    would grow over its edge with time.
    """
    for r in range(patch_shown.shape[0]):
        for c in range(patch_shown.shape[1]):
            at = row + r, column + c
            shown[at] += patch_shown[r, c]
            denied[at] += patch_denied[r, c]
            hits[at] += patch_hits[r, c]
            if patch_beside[r, c] > 0:
                beside[at] = patch_beside[r, c]
            seen[at] = shown[at] > 0 and shown[at] >= denied[at]


@kernel
def _may_touch(index, other, shapes, lows, grids, cell, reach):
    """Whether a grid's rectangle and a cell around it come within ``reach`` of the plane of another, over its cells.

    False only where one of the other grid's three axes separates the two.
    """
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
    """Sides of one grid's boundary cells: seen cells with an unseen neighbour in one of four directions.

    Returns how many there are, and row, column and direction of those whose neighbour no image explains [M, 3].
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
                    for i in range(total):  # assigning slices takes five seconds to compile
                        for m in range(3):
                            more[i, m] = found[i, m]
                    found = more
                found[total, 0], found[total, 1], found[total, 2] = r, c, k
                total += 1
    return sides, found[:total].copy()


@kernel
def open_sides(edges, ends, near, starts, shapes, lows, grids, cell, reach, step):
    """Those sides of all nodes' boundary cells that no other plane closes.

    ``edges`` [M, 3] are row, column and direction of the sides, those of node k end at ``ends[k]``. A side is closed
    when another plane passes within ``reach`` metres of the centre of the cell beyond it (``near`` = seen, dilated by
    the reach; the flat array holds all grids, node k at ``starts[k]``); ``lows`` [N, 2] is the cell index of each
    array's first entry.

    Returns for every open side the world point ``step`` metres outwards of the cell's centre [K, 3] and its node [K].
    """
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
            if j != index and _may_touch(index, j, shapes, lows, grids, cell, reach):
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
    """Cut holes into tiles, and of each take the cell nearest to the mean of the tile's cells.

    ``labels`` [R, C] names the hole of every cell below ``count``, 0 = none; ``depth`` [R, C] is the distance to the
    hole's edge in cells. Holes narrower than ``min_radius`` and tiles of fewer than ``min_cells`` cells are left out.
    Tiles start at the hole's own corner: the same hole gives the same cells wherever the grid begins.

    Returns the cells [D, 2] and the size of each one's tile [D], by hole, then by tile.
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
    sums = np.zeros((total, 3))  # cells, rows, columns
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
                    # Six digits: of cells as near as each other the first one, whatever the rounding.
                    away = np.rint(((r - sums[t, 1] / sums[t, 0]) ** 2 + (c - sums[t, 2] / sums[t, 0]) ** 2) * 1e6)
                    if away < best[t]:
                        best[t] = away
                        chosen[t, 0], chosen[t, 1] = r, c
    large = sums[:, 0] >= min_cells
    return chosen[large], sums[large, 0].astype(np.int64)
