"""Compute the compiled loops between an image and the grids of planes.

The frame of a grid is passed as twelve numbers: origin (metres, world), two axes and normal. Cell (r, c) covers ``[r, r
+ 1) x [c, c + 1)`` cells along the axes from the origin.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.planes.detection_kernels import MOMENTS, add_point, noise

UNKNOWN, OPEN, COVERED = 0, 1, 2  # unseen cells: nothing observed, ray passes through, another object


class LabelledImage(NamedTuple):
    """Hold a depth image, its planar segments and its pose as one kernel argument."""

    depth: np.ndarray  # [H, W] float32 metres
    labels: np.ndarray  # [H, W] int32 segment of each pixel, -1 = none
    table: np.ndarray  # [S] int64 grid of each segment, -1 = none
    lens: np.ndarray  # [4] fx, fy, cx, cy, pixels
    rotation: np.ndarray  # [3, 3] world from camera
    translation: np.ndarray  # [3] metres, world


class Rectangles(NamedTuple):
    """Hold for each of T grids the rectangle of cells that an image may observe; all cells are in one flat array."""

    grids: np.ndarray  # [T, 12] frames
    cell: float  # metres
    extents: np.ndarray  # [T, 4] int64: first row, first column, last row, last column
    starts: np.ndarray  # [T + 1] int64: the cells of grid t are [starts[t], starts[t + 1]), row-major


class Votes(NamedTuple):
    """Hold the observations in the cells of a grid or of a rectangle, as in `surface.SurfaceGrid`."""

    shown: np.ndarray  # [R, C] int32; uint8 for one image
    denied: np.ndarray  # [R, C] int32; uint8 for one image
    hits: np.ndarray  # [R, C] int32
    beside: np.ndarray  # [R, C] uint8


@kernel
def _lift(u, v, depth, lens, rotation, translation):
    """Return the world point of the centre of pixel (u, v) with a depth in metres.

    ``lens`` is fx, fy, cx, cy in pixels; ``rotation`` [3, 3] and ``translation`` [3] are the pose world from camera.
    """
    z = np.float64(depth)
    x, y = (u + 0.5 - lens[2]) / lens[0] * z, (v + 0.5 - lens[3]) / lens[1] * z
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + translation[0],
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + translation[1],
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + translation[2],
    )


@kernel
def cell_of(px, py, pz, grid, cell):
    """Return row and column of the cell that contains the projection of world point (px, py, pz) onto a plane.

    ``grid`` is the frame of the plane's grid, and ``cell`` the side of a cell in metres.
    """
    dx, dy, dz = px - grid[0], py - grid[1], pz - grid[2]
    row = int(np.floor((dx * grid[3] + dy * grid[4] + dz * grid[5]) / cell))
    column = int(np.floor((dx * grid[6] + dy * grid[7] + dz * grid[8]) / cell))
    return row, column


@kernel
def image_sums(image, grids, anchors, cell):
    """Return the extent of each grid's new points in cells, and their moments, in one pass over the pixels.

    ``image`` is a `LabelledImage`, ``grids`` [T, 12] are frames, and ``cell`` is the side of a cell in metres. Moments
    are taken about ``anchors`` [T, 3]. Returns extents [T, 4] (first row, first column, last row, last column), moments
    [T, 10], and row and column of the cell of each pixel [H, W, 2].
    """
    depth, labels, table, lens, rotation, translation = image
    count = len(grids)
    extents = np.empty((count, 4), np.int64)
    extents[:, :2] = 1 << 40
    extents[:, 2:] = -(1 << 40)
    moments = np.zeros((count, MOMENTS))
    cells = np.empty((*depth.shape, 2), np.int64)
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
            r, c = cell_of(px, py, pz, grids[t], cell)
            cells[v, u, 0], cells[v, u, 1] = r, c
            extents[t, 0] = min(extents[t, 0], r)
            extents[t, 1] = min(extents[t, 1], c)
            extents[t, 2] = max(extents[t, 2], r)
            extents[t, 3] = max(extents[t, 3], c)
    return extents, moments, cells


@kernel
def count_hits(labels, table, cells, extents, starts, hits):
    """Add the number of pixels in each cell to the flat array ``hits``.

    ``labels`` [H, W] and ``table`` [S] are those of `LabelledImage`, ``extents`` [T, 4] and ``starts`` [T + 1] those of
    `Rectangles`, and ``cells`` [H, W, 2] row and column of each pixel. The rectangles contain these cells.
    """
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            label = labels[v, u]
            if label < 0:
                continue
            t = table[label]
            if t >= 0:
                r, c = cells[v, u, 0] - extents[t, 0], cells[v, u, 1] - extents[t, 1]
                hits[starts[t] + r * (extents[t, 3] - extents[t, 1] + 1) + c] += 1


@kernel
def look_up_cells(image, rectangles, seen, beside, reach, tolerance, planes, facing):
    """Project the centre of every cell into the image, and record whether the image shows the grid's plane there.

    Cells are tested in the image, and not pixels in the grid, so that a cell is seen at any pixel density. So distant
    surfaces have no false holes. ``seen`` is 0 or 1. ``beside`` is the reason for an unseen cell: OPEN if the ray
    passes through the plane by more than ``reach`` metres, COVERED if something else is within ``reach`` of the plane.
    A pixel without a segment says nothing if its own point is on the plane: its depth or its incidence is beyond a
    limit of the detection. The distance is tested as in `detection_kernels.refine_pixels`. ``tolerance`` holds the
    scale of the noise, the factor on the noise, and the summand in metres.

    In a corner, noise assigns pixels of one wall to the other, and at grazing incidence such a pixel is far beyond the
    corner. So a cell next to pixels of another segment is also COVERED under two conditions. It is behind the plane of
    that segment (``planes`` [S, 4] world), and the segment is on the visible side of this plane (``facing`` [T, S]). At
    a convex edge neither plane hides the other.
    """
    depth, labels, table, lens, rotation, translation = image
    grids, cell, extents, starts = rectangles
    height, width = depth.shape
    for t in range(len(grids)):
        g = grids[t]
        # Height of the camera above the plane. The normal points to the side from which the plane is observed.
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
                            if label < 0:
                                qx, qy, qz = _lift(u, v, depth[v, u], lens, rotation, translation)
                                off = (qx - g[0]) * g[9] + (qy - g[1]) * g[10] + (qz - g[2]) * g[11]
                                sigma = noise(np.float64(depth[v, u]), tolerance[0])
                                if abs(off) < tolerance[1] * sigma + tolerance[2]:
                                    index += 1
                                    continue
                            if above < -reach:
                                beside[index] = OPEN
                            elif above <= reach:
                                beside[index] = COVERED
                index += 1


@kernel
def average_plane(normal, offset, area, seen, weight, rate):
    """Return the moving average of a plane's normal [3] and offset, and the mean normal [3] of the new segments.

    ``area`` is that of the plane in m^2. ``seen`` [K, 5] holds normal, offset and area of the new segments. ``weight``
    is the sum of these areas, each increased by 1e-12. A segment has the weight ``rate``, multiplied by its share of
    the plane's area; a rate of 0 leaves the plane unchanged.
    """
    x, y, z, d = normal[0], normal[1], normal[2], offset
    u, v, w = 0.0, 0.0, 0.0
    for n in range(len(seen)):
        if rate > 0.0:
            share = rate * min(1.0, seen[n, 4] / max(area, 1e-9))
            x = (1.0 - share) * x + share * seen[n, 0]
            y = (1.0 - share) * y + share * seen[n, 1]
            z = (1.0 - share) * z + share * seen[n, 2]
            d = (1.0 - share) * d + share * seen[n, 3]
            size = np.sqrt(x * x + y * y + z * z)
            x, y, z, d = x / size, y / size, z / size, d / size
        own = seen[n, 4] + 1e-12
        u, v, w = u + seen[n, 0] * own, v + seen[n, 1] * own, w + seen[n, 2] * own
    u, v, w = u / weight, v / weight, w / weight
    size = np.sqrt(u * u + v * v + w * w)
    return np.array([x, y, z]), d, np.array([u / size, v / size, w / size])


@kernel
def seat(axes, origin, normal, offset):
    """Return axes [3, 3] and origin [3] of a grid's frame moved onto the plane ``normal . x + offset = 0``.

    The smallest rotation from the old to the new normal is applied to the first axis, which is in the old plane.
    """
    x, y, z = normal
    turned, moved = np.empty((3, 3)), np.empty(3)
    u, v, w = axes[0]
    p, q, r = axes[2]
    share = (u * x + v * y + w * z) / (1.0 + (p * x + q * y + r * z))
    u, v, w = u - share * (p + x), v - share * (q + y), w - share * (r + z)
    share = u * x + v * y + w * z
    u, v, w = u - share * x, v - share * y, w - share * z
    size = np.sqrt(u * u + v * v + w * w)
    u, v, w = u / size, v / size, w / size
    turned[0, 0], turned[0, 1], turned[0, 2] = u, v, w
    turned[1, 0], turned[1, 1], turned[1, 2] = y * w - z * v, z * u - x * w, x * v - y * u
    turned[2, 0], turned[2, 1], turned[2, 2] = x, y, z
    away = x * origin[0] + y * origin[1] + z * origin[2] + offset
    moved[0], moved[1], moved[2] = origin[0] - away * x, origin[1] - away * y, origin[2] - away * z
    return turned, moved


@kernel
def measure(seen, hits, low, cell, axes, origin):
    """Return the number of seen cells, the number of these with a pixel, and the mean of their centres [3].

    ``seen`` [R, C] is 0 or 1, and ``hits`` [R, C] the number of pixels in each cell. The arrays begin at cell ``low``
    of the frame with ``axes`` [3, 3], ``origin`` [3] and cells of ``cell`` metres. Without a seen cell, the mean is the
    origin.
    """
    totals = np.zeros(4, np.int64)
    for r in range(seen.shape[0]):
        count, columns, measured = 0, 0, 0
        for c in range(seen.shape[1]):
            one = np.int64(seen[r, c])
            count += one  # type: ignore[assignment]
            columns += one * c  # type: ignore[assignment]
            measured += one * (hits[r, c] > 0)
        totals[0] += count
        totals[1] += count * r
        totals[2] += columns
        totals[3] += measured
    centre = origin.copy()
    if totals[0]:
        a = (totals[1] / totals[0] + low[0] + 0.5) * cell
        b = (totals[2] / totals[0] + low[1] + 0.5) * cell
        for m in range(3):
            centre[m] = origin[m] + (a * axes[0, m] + b * axes[1, m])
    return totals[0], totals[3], centre


@kernel
def even_cells(seen, hits, measured, total, count):
    """Return row and column [count, 2] of cells at even steps from the first to the last, row by row.

    The cells are the ``measured`` seen cells with a pixel, or all ``total`` seen cells if there are none. ``seen``
    [R, C] is 0 or 1, and ``hits`` [R, C] the number of pixels in each cell.
    """
    cells = np.empty((count, 2))
    last = (measured if measured else total) - 1
    number, filled = 0, 0
    for r in range(seen.shape[0]):
        inside = 0
        for c in range(seen.shape[1]):  # most rows have none of the chosen cells, and this loop is vectorised
            inside += np.int64(seen[r, c]) * (hits[r, c] > 0 or measured == 0)
        if number + inside <= filled * last // (count - 1):
            number += inside
            continue
        for c in range(seen.shape[1]):
            if seen[r, c] and (hits[r, c] > 0 or measured == 0):
                while filled < count and filled * last // (count - 1) == number:
                    cells[filled, 0], cells[filled, 1] = r, c
                    filled += 1
                number += 1
        if filled == count:
            break
    return cells


@kernel
def near_seen(points, grid, low, seen, cell, disc):
    """Return whether each of the points [P, 3], projected onto a grid's plane, is within a disc of a seen cell.

    ``disc`` [D, D] is a structuring element, and ``low`` [2] the cell at which the array ``seen`` begins.
    """
    near, reach = np.zeros(len(points), np.bool_), len(disc) // 2
    for n in range(len(points)):
        r, c = cell_of(points[n, 0], points[n, 1], points[n, 2], grid, cell)
        r, c = r - low[0] - reach, c - low[1] - reach
        for a in range(max(-r, 0), min(len(disc), seen.shape[0] - r)):
            for b in range(max(-c, 0), min(len(disc), seen.shape[1] - c)):
                if disc[a, b] and seen[r + a, c + b]:
                    near[n] = True
    return near


@kernel
def ask_cells(grid, cell, low, other, other_cell, other_low, asked, answers):
    """Read the arrays ``asked`` of another grid at the centres of a rectangle of cells, and write them to ``answers``.

    ``low`` [2] is the first cell of the rectangle. The other grid has the frame ``other``, cells of ``other_cell``
    metres, and arrays that begin at its cell ``other_low``. Cells outside the other grid keep the value 0.
    """
    shown, denied, hits, beside = asked
    to_shown, to_denied, to_hits, to_beside = answers
    for r in range(to_shown.shape[0]):
        a = (low[0] + r + 0.5) * cell
        for c in range(to_shown.shape[1]):
            b = (low[1] + c + 0.5) * cell
            px, py = grid[0] + (a * grid[3] + b * grid[6]), grid[1] + (a * grid[4] + b * grid[7])
            i, j = cell_of(px, py, grid[2] + (a * grid[5] + b * grid[8]), other, other_cell)
            i, j = i - other_low[0], j - other_low[1]
            if 0 <= i < shown.shape[0] and 0 <= j < shown.shape[1]:
                to_shown[r, c], to_denied[r, c] = shown[i, j], denied[i, j]
                to_hits[r, c], to_beside[r, c] = hits[i, j], beside[i, j]


@kernel
def join(votes, patch, row, column, seen):
    """Add the observations ``patch`` of one image to the observations ``votes`` of a grid, starting at (row, column).

    A cell is seen if it was observed at least as often as this plane as as something else. Where two planes meet, noise
    sometimes assigns a pixel to the wrong plane, and the majority keeps planes from growing beyond their edges.
    """
    shown, denied, hits, beside = votes
    patch_shown, patch_denied, patch_hits, patch_beside = patch
    for r in range(patch_shown.shape[0]):
        for c in range(patch_shown.shape[1]):
            at = row + r, column + c
            shown[at] += patch_shown[r, c]
            denied[at] += patch_denied[r, c]
            hits[at] += patch_hits[r, c]
            if patch_beside[r, c] > 0:
                beside[at] = patch_beside[r, c]
            seen[at] = shown[at] > 0 and shown[at] >= denied[at]
