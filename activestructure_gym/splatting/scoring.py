"""Run the kernels that render depth and alpha of many small images, for scoring candidates.

A thread takes one camera at a time. It finds the Gaussians that may reach a pixel and sorts them by depth. Then it
projects 16 of them at a time and blends each into the whole image, in windows of 4 x 4 pixels that begin at the first
pixel of the Gaussian's bounding box. A Gaussian of one window is skipped if no pixel of its box takes more light. There
are no tiles, since these images fit into a cache.

The images have the same bits as those of `kernels`, because the operations on a pixel are the same. `kernels` computes
offsets from a block of a tile, so ``lattice`` holds the tile and the block of every column and row (`_write_lattice`).
"""

# mypy: ignore-errors
# (the arguments of kernels have numba's types, and intrinsics are called without their typing context)

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.splatting.blending import stopped
from activestructure_gym.splatting.counters import take_ticket
from activestructure_gym.splatting.elementary import exp2_hot, larger, smaller
from activestructure_gym.splatting.layout import (
    BLUR,
    CAPACITY,
    CHUNK,
    CHUNKS,
    COUNT,
    CX,
    CY,
    DIGITS,
    FX,
    FY,
    HEIGHT,
    HIGH_X,
    HIGH_Y,
    LOG2_255,
    LOW_X,
    LOW_Y,
    MAX_ALPHA,
    MIN_DEPTH,
    MIN_LEFT,
    MIN_POWER,
    NEAR_PLANE,
    RECORD,
    ROOT,
    SLACK,
    TILE,
    WIDTH,
)
from activestructure_gym.splatting.memory import (
    load,
    load_block,
    load_columns,
    load_rows_transposed,
    lowest_bit,
    peek,
    peek_bits,
    poke,
    prefetch,
    scratch_of,
    store,
    store_block,
    store_transposed,
)
from activestructure_gym.splatting.projection import camera_point, ellipse_of, shape_of
from activestructure_gym.splatting.simd import (
    LANES,
    U64,
    F,
    bits,
    ceil,
    floor,
    fma,
    inline,
    inner,
    lane_index,
    neg,
    sel,
    spread,
    sqrt,
)

_SIDE, _LATTICE = 4, 3  # pixels per side of a window; rows of the lattice
# Fields of 16 projected Gaussians, one vector each. The last four are the bounding box in whole pixels.
_U, _V, _L00, _L01, _L11, _LOG_OPACITY, _Z, _SLOPE_T, _SLOPE_S, _LEFT, _TOP, _RIGHT, _BOTTOM, _FIELDS = range(14)
_DIGIT = 11  # bits of a digit of the sort
_AHEAD = 32  # Gaussians by which data are fetched before they are projected


@kernel
def shape(tickets, parameters, grid, shapes, reaches):
    """Compute the camera-independent data of every Gaussian for `score`.

    ``shapes`` has 16 floats each (`shape_of`). ``reaches`` [capacity] is an upper bound of the distance in metres from
    the mean at which it is visible. It is negative for a Gaussian that is visible nowhere.
    """
    capacity = grid[CAPACITY]
    while True:
        chunk = take_ticket(tickets, 0)
        if chunk >= grid[CHUNKS]:
            return
        for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, grid[COUNT]), LANES):
            own = shape_of(parameters, capacity, i)
            store_transposed(shapes, RECORD * i, own)
            store(reaches, i, _reach_of(own, parameters, capacity, i, grid[COUNT]))


@inline
def _reach_of(own, parameters, capacity, i, count):
    """Return ``reaches`` of 16 Gaussians, whose data by `shape_of` are ``own``."""
    inside = own[15] + LOG2_255
    limit = spread(F(40.0))
    live = (lane_index() < F(count - i)) & (inside >= F(0.0))
    live = live & (load(parameters, 7 * capacity + i) < limit) & (load(parameters, 8 * capacity + i) < limit)
    live = live & (load(parameters, 9 * capacity + i) < limit)
    far = spread(F(1e15))
    for axis in range(3):
        live = live & (own[axis] < far) & (own[axis] > neg(far))
    largest = larger(own[12], larger(own[13], own[14]))
    return sel(live, sqrt(larger(inside, spread(F(0.0)))) * (F(1.002) / ROOT) * largest, F(-1e30))


@kernel
def score(tickets, parameters, shapes, reaches, views, grid, values, images):
    """Render depth and alpha of many cameras; each thread renders one camera at a time.

    ``views`` [C, VIEW_SIZE] are the cameras, ``shapes`` and ``reaches`` the data from `shape`, and ``grid`` the sizes.
    ``values`` [N], one per Gaussian, are blended instead of depths if they are not empty. ``images`` [2, C * H * W] get
    depth and alpha.
    """
    depth, alpha = images[0], images[1]
    width, height = grid[WIDTH], grid[HEIGHT]
    stride, span = width + _SIDE, max(width, height) + _SIDE
    lattice = scratch_of(2 * _SIDE * _LATTICE * span)
    _write_lattice(lattice, span)
    rest, deep = scratch_of(stride * (height + _SIDE)), scratch_of(stride * (height + _SIDE))
    keys, spare = np.empty(grid[COUNT] + LANES, np.uint64), np.empty(grid[COUNT] + LANES, np.uint64)
    digits, splats, line = np.empty(2 * DIGITS, np.int64), scratch_of(LANES * _FIELDS), scratch_of(LANES)
    while True:
        camera = take_ticket(tickets, 0)
        if camera >= views.shape[0]:
            return
        view = views[camera]
        count = _find(parameters, reaches, view, grid, keys, line)
        _sort(keys, spare, count, digits)
        for at in range(stride * (height + _SIDE)):
            poke(rest, at, F(1.0))
            poke(deep, at, F(0.0))
        for place in range(count, count + LANES):
            poke(keys, place, U64(0))
        for first in range(0, count, LANES):
            live = _project(keys, first, count - first, shapes, values, view, grid, splats)
            _blend(live, splats, view, lattice, span, rest, deep, stride)
        place = camera * width * height
        for row in range(height):
            for column in range(width):
                poke(alpha, place, F(1.0) - abs(peek(rest, row * stride + column)))
                poke(depth, place, peek(deep, row * stride + column))
                place += 1


@inner
def _write_lattice(lattice, span):
    """Write three rows of ``span`` columns or rows of pixels, and again with every number four times in a row.

    They are the pixel's centre in its block of 4 x 4 pixels, the first pixel of its tile, and that of its block there.
    """
    for at in range(span):
        for kind in range(_LATTICE):
            value = F(at % 4) + F(0.5)
            if kind > 0:
                value = F(TILE * (at // TILE)) if kind == 1 else F(at % TILE // 4 * 4)
            poke(lattice, kind * span + at, value)
            for column in range(_SIDE):
                poke(lattice, _SIDE * ((_LATTICE + kind) * span + at) + column, value)


@inner
def _find(parameters, reaches, view, grid, keys, line):
    """Write the keys of the Gaussians that may reach a pixel: bits of the depth, then index. Return their number.

    A side of the image is a plane. A Gaussian is left out if it is behind one of the planes by more than its reach.
    """
    capacity, count = grid[CAPACITY], 0
    # Bounds of the Jacobian's rows times depth, and of what blur and slack add in pixels.
    along = view[FX] * np.sqrt(F(1.0) + max(view[LOW_X] * view[LOW_X], view[HIGH_X] * view[HIGH_X]))
    down = view[FY] * np.sqrt(F(1.0) + max(view[LOW_Y] * view[LOW_Y], view[HIGH_Y] * view[HIGH_Y]))
    more = F(3.34) * np.sqrt(view[BLUR]) + F(2.0) * SLACK - F(0.5)
    left, right = view[CX] + more, view[CX] - more - F(grid[WIDTH])
    top, bottom = view[CY] + more, view[CY] - more - F(grid[HEIGHT])
    for i in range(0, grid[COUNT], LANES):
        x, y, z = camera_point(parameters, capacity, i, view)
        reach = load(reaches, i)
        x, y = x * view[FX], y * view[FY]
        wide, tall = reach * along, reach * down
        margin = smaller(fma(z, left, x) + wide, wide - fma(z, right, x))
        margin = smaller(margin, smaller(fma(z, top, y) + tall, tall - fma(z, bottom, y)))
        seen = np.int64(bits(smaller(margin, z - NEAR_PLANE) >= F(0.0)))
        if seen != 0:
            store(line, 0, z)
            while seen != 0:
                lane = lowest_bit(seen)
                seen &= seen - 1
                poke(keys, count, (U64(peek_bits(line, lane)) << U64(32)) | U64(i + lane))
                count += 1
    return count


@inner
def _sort(keys, spare, count, digits):
    """Sort keys by depth, with ties by index: by two digits of the depth's bits, then by insertion.

    Both digits together are the 22 high bits in which depths differ. The few bits below them are left to the insertion.
    """
    if count == 0:
        return
    nearest = farthest = peek(keys, 0)
    for i in range(count):
        key = peek(keys, i)
        nearest, farthest = min(nearest, key), max(farthest, key)
    nearest, width = nearest >> U64(32), 0
    while (((farthest >> U64(32)) - nearest) >> U64(width)) != U64(0):
        width += 1
    shift = 32 + max(0, width - 2 * _DIGIT)
    low = U64((1 << _DIGIT) - 1)
    base = nearest << U64(32)
    size = 1 << _DIGIT
    for digit in range(2 * size):
        poke(digits, digit, np.int64(0))
    for i in range(count):
        key = (peek(keys, i) - base) >> U64(shift)
        a, b = np.int64(key & low), size + np.int64(key >> U64(_DIGIT))
        poke(digits, a, peek(digits, a) + 1)
        poke(digits, b, peek(digits, b) + 1)
    p, q = 0, 0
    for digit in range(size):
        own, other = peek(digits, digit), peek(digits, size + digit)
        poke(digits, digit, p)
        poke(digits, size + digit, q)
        p += own
        q += other
    for i in range(count):
        key = peek(keys, i)
        digit = np.int64(((key - base) >> U64(shift)) & low)
        place = peek(digits, digit)
        poke(digits, digit, place + 1)
        poke(spare, place, key)
    for i in range(count):
        key = peek(spare, i)
        digit = size + np.int64((key - base) >> U64(shift + _DIGIT))
        place = peek(digits, digit)
        poke(digits, digit, place + 1)
        poke(keys, place, key)
    for i in range(1, count):
        key = peek(keys, i)
        j = i - 1
        while j >= 0 and peek(keys, j) > key:
            poke(keys, j + 1, peek(keys, j))
            j -= 1
        poke(keys, j + 1, key)


@inner
def _project(keys, first, count, shapes, values, view, grid, splats):
    """Project 16 Gaussians from ``keys[first]`` on into ``splats``; return the bits of those that may reach a pixel."""
    for ahead in range(first + _AHEAD, first + _AHEAD + LANES):
        prefetch(shapes, RECORD * np.int64(peek(keys, min(ahead, first + count - 1)) & U64(0xFFFFFFFF)))
    own = load_rows_transposed(shapes, keys, first)
    live = lane_index() < F(count)
    live, inside, u, v, z, l00, l01, l11, slope_t, slope_s, xx, _, yy = ellipse_of(live, own, view)
    store(splats, LANES * _U, u)
    store(splats, LANES * _V, v)
    store(splats, LANES * _L00, l00)
    store(splats, LANES * _L01, l01)
    store(splats, LANES * _L11, l11)
    store(splats, LANES * _LOG_OPACITY, own[15])
    store(splats, LANES * _Z, z)
    store(splats, LANES * _SLOPE_T, slope_t)
    store(splats, LANES * _SLOPE_S, slope_s)
    if len(values) != 0:
        store(splats, LANES * _SLOPE_T, spread(F(0.0)))
        store(splats, LANES * _SLOPE_S, spread(F(0.0)))
        for lane in range(min(count, LANES)):
            value = peek(values, np.int64(peek(keys, first + lane) & U64(0xFFFFFFFF)))
            poke(splats, LANES * _Z + lane, value)
    root = sqrt(inside) * (F(1.0) / ROOT)
    radius_x, radius_y = fma(root, sqrt(xx), spread(SLACK)), fma(root, sqrt(yy), spread(SLACK))
    far, half, zero = spread(F(1e6)), F(0.5), spread(F(0.0))
    left = larger(ceil(larger(u - radius_x, neg(far)) - half), zero)
    top = larger(ceil(larger(v - radius_y, neg(far)) - half), zero)
    right = smaller(floor(smaller(u + radius_x, far) - half), spread(F(grid[WIDTH] - 1)))
    bottom = smaller(floor(smaller(v + radius_y, far) - half), spread(F(grid[HEIGHT] - 1)))
    store(splats, LANES * _LEFT, left)
    store(splats, LANES * _TOP, top)
    store(splats, LANES * _RIGHT, right)
    store(splats, LANES * _BOTTOM, bottom)
    return bits(live & (left <= right) & (top <= bottom))


@inline
def _all_stopped(rest, stride, x, y, right, bottom):
    """Return whether blending has ended at all pixels from (x, y) to (right, bottom), which lie in one window."""
    columns = (np.int64(1) << min(right - x + 1, _SIDE)) - 1
    pixels = columns * (np.int64(0x1111) & ((np.int64(1) << (_SIDE * min(bottom - y + 1, _SIDE))) - 1))
    return np.int64(bits(load_block(rest, y * stride + x, stride) > F(0.0))) & pixels == 0


@inner
def _blend(live, splats, view, lattice, span, rest, deep, stride):
    """Blend the Gaussians with a bit in ``live`` into the images, in order of their lanes."""
    while live != 0:
        lane = lowest_bit(live)
        live &= live - 1
        left, right = np.int64(peek(splats, LANES * _LEFT + lane)), np.int64(peek(splats, LANES * _RIGHT + lane))
        top, bottom = np.int64(peek(splats, LANES * _TOP + lane)), np.int64(peek(splats, LANES * _BOTTOM + lane))
        x, y = left, top
        if right - x < _SIDE and bottom - y < _SIDE and _all_stopped(rest, stride, x, y, right, bottom):
            continue
        u, v = spread(peek(splats, LANES * _U + lane)), spread(peek(splats, LANES * _V + lane))
        z = spread(peek(splats, LANES * _Z + lane))
        l00, l01 = spread(peek(splats, LANES * _L00 + lane)), spread(peek(splats, LANES * _L01 + lane))
        l11, log_opacity = spread(peek(splats, LANES * _L11 + lane)), spread(peek(splats, LANES * _LOG_OPACITY + lane))
        slope_t = spread(peek(splats, LANES * _SLOPE_T + lane))
        slope_s = spread(peek(splats, LANES * _SLOPE_S + lane))
        while True:
            dx = load_columns(lattice, x) - (u - load_columns(lattice, span + x))
            dy = load(lattice, 4 * (3 * span + y)) - (v - load(lattice, 4 * (4 * span + y)))
            by = load(lattice, 4 * (5 * span + y))
            s = fma(l11, by, dy * l11)
            t = fma(l00, load_columns(lattice, 2 * span + x), fma(l01, by, fma(dx, l00, dy * l01)))
            power = fma(neg(s), s, fma(neg(t), t, log_opacity))
            opaque = smaller(exp2_hot(power, view), spread(peek(view, MAX_ALPHA)))
            opaque = sel(power >= peek(view, MIN_POWER), opaque, F(0.0))
            at = y * stride + x
            before = load_block(rest, at, stride)
            after = fma(neg(opaque), before, before)
            goes_on = after > peek(view, MIN_LEFT)
            weight = sel(goes_on, opaque, F(0.0)) * before
            store_block(rest, at, stride, sel(goes_on, after, stopped(before)))
            here = larger(fma(slope_t, t, fma(slope_s, s, z)), spread(peek(view, MIN_DEPTH)))
            store_block(deep, at, stride, fma(weight, here, load_block(deep, at, stride)))
            x += _SIDE
            if x > right:
                x = left
                y += _SIDE
                if y > bottom:
                    break
