"""Blend the Gaussians of a tile front to back, and compute the gradients in the backward pass.

A tile has 8 x 8 blocks of 4 x 4 pixels, and a block is one vector of 16 floats. The state of a block is in the array
``state``; a pixel that has stopped stores its negative transmittance. ``base`` is the offset of a Gaussian's record in
``records``, ``view`` holds the camera and ``grid`` the sizes of the rendering (`layout`).
"""

# mypy: ignore-errors
# (the arguments of kernels have numba's types, and intrinsics are called without their typing context)

from __future__ import annotations

import numpy as np

from activestructure_gym.splatting.elementary import exp2_hot, larger, smaller
from activestructure_gym.splatting.layout import (
    BLUE,
    DEPTH,
    GREEN,
    HEIGHT,
    L00,
    L01,
    L11,
    LOG_OPACITY,
    MARGIN,
    MAX_ALPHA,
    MIN_DEPTH,
    MIN_LEFT,
    MIN_POWER,
    ONE,
    RECORD,
    RED,
    SLOPE_S,
    SLOPE_T,
    SORTED_REACH,
    SORTED_SPLAT,
    STRIDE,
    TILE,
    TILE_BLOCKS,
    TILES_X,
    WIDTH,
    U,
    V,
)
from activestructure_gym.splatting.memory import (
    load,
    load_block,
    load_color_block,
    lowest_bit,
    peek,
    poke,
    prefetch,
    store,
    store_block,
    store_color_block,
    sums,
)
from activestructure_gym.splatting.simd import (
    LANES,
    U64,
    F,
    bits,
    float_bits,
    fma,
    inline,
    inner,
    int_bits,
    lane_x,
    lane_y,
    neg,
    sel,
    spread,
)

_BLOCK_X = np.array([4 * (block % 8) for block in range(64)], np.float32)
_BLOCK_Y = np.array([4 * (block // 8) for block in range(64)], np.float32)


@inline
def corner_of(tile, grid):
    """Return column and row of the first pixel of a tile."""
    return TILE * (tile % grid[TILES_X]), TILE * (tile // grid[TILES_X])


@inline
def open_tile(tile, grid, state, width):
    """Set the state of a tile: transmittance 1 inside the image and -1 outside, the rest 0.

    ``width`` is the number of floats per block. Returns one bit per block that has pixels inside the image.
    """
    tiles_x, zero = grid[TILES_X], spread(F(0.0))
    alive = 0
    for offset in range(0, width * grid[TILE_BLOCKS], LANES):
        store(state, offset, zero)
    for block in range(grid[TILE_BLOCKS]):
        x = TILE * (tile % tiles_x) + 4 * (block & 7)
        y = TILE * (tile // tiles_x) + 4 * (block >> 3)
        if x < grid[WIDTH] and y < grid[HEIGHT]:
            alive |= 1 << block
        inside = (lane_x() < F(grid[WIDTH] - x)) & (lane_y() < F(grid[HEIGHT] - y))
        store(state, width * block, sel(inside, F(1.0), F(-1.0)))
    return alive


@inline
def _fetch_ahead(entries, entry, stop, records):
    """Prefetch the record of the entry six places after ``entry``, but before ``stop``.

    Its address is random, so the processor cannot predict it.
    """
    later = peek(entries, SORTED_SPLAT * entries.shape[1] + min(entry + 6, stop - 1))
    prefetch(records, RECORD * np.int64(later & U64(0xFFFFFFFF)))


@inline
def stopped(transmittance):
    """Return the transmittance with a negative sign, which marks pixels whose blending has ended."""
    return float_bits(int_bits(transmittance) | np.int32(-0x80000000))


@inline
def place_of(records, base, block, along, across):
    """Return t and s of a Gaussian at the 16 pixels of a block, with alpha = opacity 2^-(t^2 + s^2).

    ``along`` and ``across`` are its t and s in the first block of the tile (`splat_at`).
    """
    bx, by = peek(_BLOCK_X, block), peek(_BLOCK_Y, block)
    t = fma(spread(peek(records, base + L00)), bx, fma(spread(peek(records, base + L01)), by, along))
    return t, fma(spread(peek(records, base + L11)), by, across)


@inline
def alpha_of(records, base, block, along, across, view):
    """Return the alpha of a Gaussian at the 16 pixels of a block; 0 where it is below 1/255.

    ``along`` and ``across`` are its t and s in the first block of the tile (`splat_at`).
    """
    t, s = place_of(records, base, block, along, across)
    return alpha_at(records, base, t, s, view)


@inline
def alpha_at(records, base, t, s, view):
    """Return the alpha of a Gaussian at 16 pixels with the given t and s; 0 where it is below 1/255."""
    power = fma(neg(s), s, fma(neg(t), t, peek(records, base + LOG_OPACITY)))
    alpha = smaller(exp2_hot(power, view), spread(peek(view, MAX_ALPHA)))
    return sel(power >= peek(view, MIN_POWER), alpha, F(0.0))


@inline
def depth_at(records, base, z, t, s, view):
    """Return the depth at which the rays of 16 pixels meet a Gaussian, to first order, at least the near plane's.

    ``z`` is the depth of its mean, and t and s are its whitened offsets at the pixels (`place_of`).
    """
    depth = fma(spread(peek(records, base + SLOPE_T)), t, fma(spread(peek(records, base + SLOPE_S)), s, z))
    return larger(depth, spread(peek(view, MIN_DEPTH)))


# Floats of state per block. While blending: transmittance, depth, red, green, blue. In the backward pass:
# transmittance, remaining sum, gradients with respect to red, green, blue, depth, alpha.
COLORED_STATE = 112


@inline
def splat_at(records, base, x, y):
    """Return the whitened offsets t and s from the mean of a Gaussian to the 16 pixels of the block at pixel (x, y).

    `place_of` computes the offsets in the other blocks of the tile from them.
    """
    dx, dy = lane_x() - (peek(records, base + U) - x), lane_y() - (peek(records, base + V) - y)
    along = fma(dx, peek(records, base + L00), dy * peek(records, base + L01))
    return along, dy * peek(records, base + L11)


@inner
def blend_forward(tile, alive, lists, state, kept, keeps):
    """Blend the entries of a tile into ``state``.

    Return the first entry that was not needed, as all pixels had stopped. ``alive`` has one bit per block with
    unstopped pixels. The alphas are written to ``kept``, ``keeps`` floats apart, with 0 for stopped pixels. The blocks
    that each entry reached replace its reach, so that the backward loop visits the same blocks.
    """
    entries, records, view = lists.entries, lists.records, lists.camera
    start, stop = lists.tile_start[tile], lists.tile_start[tile + 1]
    left, top = corner_of(tile, lists.grid)
    x, y = F(left), F(top)
    room, at_kept = entries.shape[1], 0
    for entry in range(start, stop):
        if alive == 0:
            return entry
        _fetch_ahead(entries, entry, stop, records)
        reach = np.int64(peek(entries, SORTED_REACH * room + entry)) & alive
        poke(entries, SORTED_REACH * room + entry, U64(reach))
        if reach == 0:
            continue
        base = RECORD * np.int64(peek(entries, SORTED_SPLAT * room + entry) & U64(0xFFFFFFFF))
        along, across = splat_at(records, base, x, y)
        z = spread(peek(records, base + DEPTH))
        r, g, b = (
            spread(peek(records, base + RED)), spread(peek(records, base + GREEN)),
            spread(peek(records, base + BLUE)),
        )  # fmt: skip
        while reach != 0:
            block = lowest_bit(reach)
            reach &= reach - 1
            at = COLORED_STATE * block
            t, s = place_of(records, base, block, along, across)
            opaque = alpha_at(records, base, t, s, view)
            before = load(state, at)
            after = fma(neg(opaque), before, before)
            goes_on = after > peek(view, MIN_LEFT)
            opaque = sel(goes_on, opaque, F(0.0))
            weight = opaque * before
            # A branch hides the latency of this test from the next Gaussian on the block (measured).
            if bits(goes_on) != 0xFFFF:
                after = sel(goes_on, after, stopped(before))
                if bits(goes_on) == 0:
                    alive &= ~(1 << block)
            store(state, at, after)
            here = depth_at(records, base, z, t, s, view)
            store(state, at + 16, fma(weight, here, load(state, at + 16)))
            store(state, at + 32, fma(weight, r, load(state, at + 32)))
            store(state, at + 48, fma(weight, g, load(state, at + 48)))
            store(state, at + 64, fma(weight, b, load(state, at + 64)))
            store(kept, at_kept, opaque)
            prefetch(kept, at_kept + 16 * LANES)  # a write to a distant cache line costs more than the block
            at_kept += keeps
    return stop


@inner
def _find_again(reach, records, base, along, across, view, state, kept):
    """Compute the alphas of one entry again, because `blend_forward` had no space to store them.

    ``reach`` has one bit per block that the entry reached. The alphas are written to ``kept``.
    """
    at_kept = 0
    while reach != 0:
        block = lowest_bit(reach)
        reach &= reach - 1
        opaque = alpha_of(records, base, block, along, across, view)
        before = load(state, COLORED_STATE * block)
        goes_on = fma(neg(opaque), before, before) > peek(view, MIN_LEFT)
        store(kept, at_kept, sel(goes_on, opaque, F(0.0)))
        at_kept += LANES
        before = before + F(0.0)
        store(state, COLORED_STATE * block, sel(goes_on, before, stopped(before)))


@inner
def blend_backward(tile, done, lists, state, kept, keeps, slots):
    """Process the entries of a tile before ``done`` front to back, and write each entry's gradient sums to ``slots``.

    For each pixel, R is the sum C.gC + D gD + A gA over the Gaussians not yet processed, with gC, gD and gA the
    gradients with respect to colour, depth and alpha. Each Gaussian's share is subtracted in turn, without division or
    reversal of the order. With s = c.gC + z gD + gA and weight w, v = alpha dL/dalpha = w s - alpha / (1 - alpha) R.
    ``kept`` and ``keeps`` are those of `blend_forward`; with ``keeps`` = 0 the alphas are computed again.
    """
    entries, records, view = lists.entries, lists.records, lists.camera
    start, stop = lists.tile_start[tile], lists.tile_start[tile + 1]
    left, top = corner_of(tile, lists.grid)
    x, y = F(left), F(top)
    room, zero, at_kept = entries.shape[1], spread(F(0.0)), 0
    for entry in range(start, done):
        _fetch_ahead(entries, entry, done, records)
        packed = peek(entries, SORTED_SPLAT * room + entry)
        slot = LANES * np.int64(packed >> U64(32))
        reach = np.int64(peek(entries, SORTED_REACH * room + entry))
        if reach == 0:
            store(slots, slot, zero)
            continue
        base = RECORD * np.int64(packed & U64(0xFFFFFFFF))
        along, across = splat_at(records, base, x, y)
        if keeps == 0:
            at_kept = 0
            _find_again(reach, records, base, along, across, view, state, kept)
        r, g, b, z = (
            spread(peek(records, base + RED)), spread(peek(records, base + GREEN)),
            spread(peek(records, base + BLUE)), spread(peek(records, base + DEPTH)),
        )  # fmt: skip
        m0, m1, m2, m3, m4, m5 = zero, zero, zero, zero, zero, zero
        w_r, w_g, w_b, w_z, w_all, w_zt, w_zs = zero, zero, zero, zero, zero, zero, zero
        while reach != 0:
            block = lowest_bit(reach)
            reach &= reach - 1
            at = COLORED_STATE * block
            t, s = place_of(records, base, block, along, across)
            opaque = load(kept, at_kept)
            prefetch(kept, at_kept + 32 * LANES)  # alphas that `blend` stored for a whole image are not in the cache
            at_kept += LANES
            before = load(state, at)
            weight = opaque * before
            store(state, at, before - weight)
            g_r, g_g, g_b = load(state, at + 32), load(state, at + 48), load(state, at + 64)
            g_z = load(state, at + 80)
            here = depth_at(records, base, z, t, s, view)
            term = weight * fma(r, g_r, fma(g, g_g, fma(b, g_b, fma(here, g_z, load(state, at + 96)))))
            rest = load(state, at + 16) - term
            store(state, at + 16, rest)
            w_r, w_g, w_b = fma(weight, g_r, w_r), fma(weight, g_g, w_g), fma(weight, g_b, w_b)
            by_depth = sel(here > peek(view, MIN_DEPTH), weight * g_z, F(0.0))
            w_z, w_all = w_z + by_depth, w_all + weight
            w_zt, w_zs = fma(by_depth, t, w_zt), fma(by_depth, s, w_zs)
            v = term - opaque / (peek(view, ONE) - opaque) * rest
            v = sel(opaque < peek(view, MAX_ALPHA), v, F(0.0))  # an alpha at its upper limit has no gradient
            vt, vs = v * t, v * s
            m0, m1, m2 = m0 + v, m1 + vt, m2 + vs
            m3, m4, m5 = fma(vt, t, m3), fma(vt, s, m4), fma(vs, s, m5)
        store(slots, slot, sums((m0, m1, m2, m3, m4, m5, w_r, w_g, w_b, w_z, w_all, w_zt, w_zs)))
    for entry in range(done, stop):
        store(slots, LANES * np.int64(peek(entries, SORTED_SPLAT * room + entry) >> U64(32)), zero)


@inner
def write_tile(tile, grid, state, pictures):
    """Write the blocks of a tile into the images ``pictures``."""
    color, depth, alpha = pictures
    x, y = corner_of(tile, grid)
    for block in range(grid[TILE_BLOCKS]):
        left, top, at = x + 4 * (block & 7), y + 4 * (block >> 3), COLORED_STATE * block
        pixel, place = top * grid[WIDTH] + left, top * grid[STRIDE] + grid[MARGIN] + 3 * left
        if left + 4 <= grid[WIDTH] and top + 4 <= grid[HEIGHT]:
            rest = load(state, at)
            store_block(alpha, pixel, grid[WIDTH], F(1.0) - larger(rest, neg(rest)))
            store_block(depth, pixel, grid[WIDTH], load(state, at + 16))
            r, g, b = load(state, at + 32), load(state, at + 48), load(state, at + 64)
            store_color_block(color, place, grid[STRIDE], r, g, b)
            continue
        for row in range(min(4, grid[HEIGHT] - top)):
            for column in range(min(4, grid[WIDTH] - left)):
                lane = at + 4 * row + column
                poke(alpha, pixel + row * grid[WIDTH] + column, F(1.0) - abs(peek(state, lane)))
                poke(depth, pixel + row * grid[WIDTH] + column, peek(state, lane + 16))
                for channel in range(3):
                    value = peek(state, lane + 32 + 16 * channel)
                    poke(color, place + row * grid[STRIDE] + 3 * column + channel, value)


@inner
def read_tile(tile, grid, state, pictures, by_pictures, by_layout):
    """Set the state of the backward loop from the images ``pictures`` and their gradients ``by_pictures``.

    ``by_layout`` [2] is the number of floats per row of the colour gradient, and before the first pixel of a row.
    """
    color, depth, alpha = pictures
    by_color, by_depth, by_alpha = by_pictures
    x, y = corner_of(tile, grid)
    open_tile(tile, grid, state, np.int64(COLORED_STATE))
    for block in range(grid[TILE_BLOCKS]):
        left, top, at = x + 4 * (block & 7), y + 4 * (block >> 3), COLORED_STATE * block
        pixel, place = top * grid[WIDTH] + left, top * grid[STRIDE] + grid[MARGIN] + 3 * left
        if left + 4 <= grid[WIDTH] and top + 4 <= grid[HEIGHT]:
            g_z, g_a = load_block(by_depth, pixel, grid[WIDTH]), load_block(by_alpha, pixel, grid[WIDTH])
            rest = load_block(depth, pixel, grid[WIDTH]) * g_z + load_block(alpha, pixel, grid[WIDTH]) * g_a
            g_r, g_g, g_b = load_color_block(by_color, top * by_layout[0] + by_layout[1] + 3 * left, by_layout[0])
            r, g, b = load_color_block(color, place, grid[STRIDE])
            store(state, at + 16, fma(r, g_r, fma(g, g_g, fma(b, g_b, rest))))
            store(state, at + 32, g_r)
            store(state, at + 48, g_g)
            store(state, at + 64, g_b)
            store(state, at + 80, g_z)
            store(state, at + 96, g_a)
            continue
        for row in range(min(4, grid[HEIGHT] - top)):
            for column in range(min(4, grid[WIDTH] - left)):
                lane, here = at + 4 * row + column, pixel + row * grid[WIDTH] + column
                rest_here = peek(depth, here) * peek(by_depth, here) + peek(alpha, here) * peek(by_alpha, here)
                poke(state, lane + 80, peek(by_depth, here))
                poke(state, lane + 96, peek(by_alpha, here))
                for channel in range(3):
                    spot = (top + row) * by_layout[0] + by_layout[1] + 3 * (left + column) + channel
                    by_channel = peek(by_color, spot)
                    rest_here += by_channel * peek(color, place + row * grid[STRIDE] + 3 * column + channel)
                    poke(state, lane + 32 + 16 * channel, by_channel)
                poke(state, lane + 16, rest_here)
