"""Compute the information of one view about every visible Gaussian, by a second pass over the tiles.

A tile is blended front to back. The second pass then goes back to front over the stored alphas, so that transmittance
and colour behind a Gaussian are both exact. Let t and s be the whitened offsets, so that alpha = 2^(lo - t^2 - s^2).
Every derivative of alpha by projected mean, conic and opacity is then alpha times a combination of b = (1, t, s, t^2, t
s, s^2). Let q be the squared derivative of the colours by log(alpha). The 21 sums over pixels of q b_i b_j then reduce
to 15 moments, the sums of q t^i s^j with i + j <= 4. They fill one vector together with the sum of the weights.

Once per Gaussian the moments are converted to the 6 x 6 block for mean and log-scales, of which the 21 entries on and
above the diagonal are stored. Source: [fisherrf], with the chain rule to mean and scale of [zwicker2002] moved out of
the sum over pixels.
"""

# mypy: ignore-errors
# (the arguments of kernels have numba's types, and intrinsics are called without their typing context)

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from activestructure_gym.compiling import kernel
from activestructure_gym.splatting import blending, layout, projection, tile_lists
from activestructure_gym.splatting.counters import STEPPED, THREAD_TICKET, TILES_DONE, all_done, take_ticket
from activestructure_gym.splatting.elementary import dot3, larger
from activestructure_gym.splatting.memory import (
    SUM_LANES,
    count_bits,
    load,
    load_sums,
    load_transposed,
    lowest_bit,
    peek,
    peek_bits,
    poke,
    prefetch,
    scratch_of,
    store,
    store_transposed,
    sums,
)
from activestructure_gym.splatting.simd import LANES, bits, fma, neg, sel, spread

_plain = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True, "_nrt": False}
_inner, _inline = njit(**_plain), njit(forceinline=True, **_plain)
F = np.float32

SLOT_FLOATS = 2 * LANES  # of an entry (a pair of tile and Gaussian): moments and sum of weights, then the other sums
# Sums in the second vector: squared weights, weight times pixel value, number of pixels.
SQUARED, GATHERED, TOUCHES = range(3)
_TOUCHES_LANE = SUM_LANES.index(TOUCHES)
# Columns of a result. First the block for mean and log-scales, row by row from the diagonal, and the entry of the
# opacity logit. Then sums over pixels: squared weights, weights, number of pixels with a transmittance in front above a
# limit, and weight times pixel value in these.
BLOCK, LOGIT, COLOR, WEIGHT, TOUCH, SCATTER, COLUMNS = 0, *range(21, 27)
RESULT_FLOATS = 2 * LANES
_STATE = 64 * blending.COLORED_STATE


class Asked(NamedTuple):
    """Hold optional inputs of the second pass: channels to blend, pixel values to sum, and the transmittance limit."""

    touch: np.float32  # a Gaussian counts in a pixel if the transmittance in front of it is above this
    width: int  # D, number of channels per Gaussian
    channels: np.ndarray  # [N * D] float32 values of the Gaussians, blended to images
    pixel_values: np.ndarray  # [H * W] float32 values of the pixels, summed per Gaussian; or empty


class Told(NamedTuple):
    """Hold the outputs of the second pass other than the images, and its workspace."""

    pictures: np.ndarray  # [H * W * D] float32 images of the channels
    slots: np.ndarray  # [entries * SLOT_FLOATS] float32, workspace for the sums of every entry
    # [capacity * RESULT_FLOATS] float32 rows `BLOCK ...` of the Gaussians with a bit in ``visible``.
    numbers: np.ndarray


@_inline
def _turn_back(state, tile, grid, pixel_values):
    """Convert the state that blending leaves to the state in which the tile is processed back to front.

    Stopped pixels get a positive transmittance again. The colour behind is 0, since no Gaussian has been processed yet.
    The pixel values are loaded if there are any.
    """
    zero, width = spread(F(0.0)), grid[layout.WIDTH]
    x, y = blending.corner_of(tile, grid)
    for block in range(grid[layout.TILE_BLOCKS]):
        at = blending.COLORED_STATE * block
        left_over = load(state, at)
        store(state, at, larger(left_over, neg(left_over)))
        for offset in range(LANES, 6 * LANES, LANES):
            store(state, at + offset, zero)
        left, top = x + 4 * (block & 7), y + 4 * (block >> 3)
        if len(pixel_values) != 0:
            for row in range(min(4, grid[layout.HEIGHT] - top)):
                for column in range(min(4, width - left)):
                    value = peek(pixel_values, (top + row) * width + left + column)
                    poke(state, at + 80 + 4 * row + column, value)


@_inner
def _write_channels(tile, grid, painted, channels, pictures):
    """Write the channels of a tile, ``painted [64, D, 16]``, into the images ``pictures [H * W * D]``."""
    x, y = blending.corner_of(tile, grid)
    for block in range(grid[layout.TILE_BLOCKS]):
        left, top = x + 4 * (block & 7), y + 4 * (block >> 3)
        for row in range(min(4, grid[layout.HEIGHT] - top)):
            for column in range(min(4, grid[layout.WIDTH] - left)):
                pixel = (top + row) * grid[layout.WIDTH] + left + column
                for channel in range(channels):
                    at = LANES * (channels * block + channel) + 4 * row + column
                    poke(pictures, pixel * channels + channel, peek(painted, at))


@_inner
def _sum_tile(tile, done, lists, state, kept, asked, painted, slots):
    """Process the entries blended into a tile back to front, and write the sums of each entry to ``slots``.

    With ``after`` the transmittance behind a Gaussian and R the colour behind it, the derivative of a colour by
    log(alpha) is alpha / (1 - alpha) (after c - R). It needs one division and no subtraction of large numbers. The sums
    of pixel values and channels are rarely used, so they are in memory behind ``painted``; the other sums just fit into
    registers. ``done`` is the first entry that was not blended, and ``kept`` holds the alphas. ``asked`` is an `Asked`.
    """
    entries, records, view = lists.entries, lists.records, lists.camera
    start, stop = lists.tile_start[tile], lists.tile_start[tile + 1]
    left, top = blending.corner_of(tile, lists.grid)
    x, y = F(left), F(top)
    touch, width, channels, gathers = asked.touch, asked.width, asked.channels, len(asked.pixel_values) != 0
    room, zero, end = entries.shape[1], spread(F(0.0)), np.int64(0)
    at_gathered = 64 * LANES * width
    for entry in range(start, done):
        end += LANES * count_bits(peek(entries, layout.SORTED_REACH * room + entry))
    for entry in range(done - 1, start - 1, -1):
        packed = peek(entries, layout.SORTED_SPLAT * room + entry)
        slot = SLOT_FLOATS * np.int64(packed >> np.uint64(32))
        bitmap = peek(entries, layout.SORTED_REACH * room + entry)
        reach = np.int64(bitmap)
        if reach == 0:
            store(slots, slot, zero)
            store(slots, slot + LANES, zero)
            continue
        splat = np.int64(packed & np.uint64(0xFFFFFFFF))
        earlier = peek(entries, layout.SORTED_SPLAT * room + max(entry - 6, start))
        prefetch(records, layout.RECORD * np.int64(earlier & np.uint64(0xFFFFFFFF)))
        base = layout.RECORD * splat
        end -= LANES * count_bits(bitmap)
        at_kept = end
        along, across = blending.splat_at(records, base, x, y)
        r, g, b = (
            spread(peek(records, base + layout.RED)), spread(peek(records, base + layout.GREEN)),
            spread(peek(records, base + layout.BLUE)),
        )  # fmt: skip
        m00, m10, m01, m20, m11, m02, m30, m21 = zero, zero, zero, zero, zero, zero, zero, zero
        m12, m03, m40, m31, m22, m13, m04 = zero, zero, zero, zero, zero, zero, zero
        weights, squares, touches = zero, zero, np.int64(0)
        store(painted, at_gathered, zero)
        while reach != 0:
            block = lowest_bit(reach)
            reach &= reach - 1
            at = blending.COLORED_STATE * block
            t, s = blending.place_of(records, base, block, along, across)
            opaque = load(kept, at_kept)
            at_kept += LANES
            after = load(state, at)
            ratio = opaque / (peek(view, layout.ONE) - opaque)
            weight = ratio * after
            before = after + weight
            store(state, at, before)
            rest_r, rest_g, rest_b = load(state, at + 32), load(state, at + 48), load(state, at + 64)
            store(state, at + 32, fma(weight, r, rest_r))
            store(state, at + 48, fma(weight, g, rest_g))
            store(state, at + 64, fma(weight, b, rest_b))
            d_r, d_g, d_b = (
                fma(after, r, neg(rest_r)), fma(after, g, neg(rest_g)), fma(after, b, neg(rest_b)),
            )  # fmt: skip
            q = ratio * ratio * fma(d_r, d_r, fma(d_g, d_g, d_b * d_b))
            q = sel(opaque < peek(view, layout.MAX_ALPHA), q, F(0.0))  # an alpha at its upper limit has no gradient
            tt, ts, ss = t * t, t * s, s * s
            q10, q01, q20, q11, q02 = q * t, q * s, q * tt, q * ts, q * ss
            m00, m10, m01 = m00 + q, m10 + q10, m01 + q01
            m20, m11, m02 = m20 + q20, m11 + q11, m02 + q02
            m30, m21, m12, m03 = fma(q20, t, m30), fma(q20, s, m21), fma(q02, t, m12), fma(q02, s, m03)
            m40, m31, m22 = fma(q20, tt, m40), fma(q20, ts, m31), fma(q20, ss, m22)
            m13, m04 = fma(q02, ts, m13), fma(q02, ss, m04)
            weights, squares = weights + weight, fma(weight, weight, squares)
            counts = (opaque > F(0.0)) & (before > touch)
            touches += count_bits(np.uint64(bits(counts)))
            if gathers:
                share = sel(counts, weight, F(0.0))
                store(painted, at_gathered, fma(share, load(state, at + 80), load(painted, at_gathered)))
            for channel in range(width):
                own = LANES * (width * block + channel)
                value = spread(peek(channels, width * splat + channel))
                store(painted, own, fma(weight, value, load(painted, own)))
        store(
            slots, slot,
            sums((m00, m10, m01, m20, m11, m02, m30, m21, m12, m03, m40, m31, m22, m13, m04, weights)),
        )  # fmt: skip
        store(slots, slot + LANES, sums((squares, load(painted, at_gathered))))
        poke(slots, slot + LANES + _TOUCHES_LANE, F(touches))
    for entry in range(done, stop):
        slot = SLOT_FLOATS * np.int64(peek(entries, layout.SORTED_SPLAT * room + entry) >> np.uint64(32))
        store(slots, slot, zero)
        store(slots, slot + LANES, zero)


@_inline
def _axis(r0, r1, r2, scale, lens, view):
    """Return one axis of 16 Gaussians: three components in the camera frame (metres), and two in the image (pixels).

    (r0, r1, r2) is the unit axis in the world and ``scale`` its length. ``lens`` holds J00, J02, J11, J12.
    """
    j00, j02, j11, j12 = lens
    k0, k1, k2 = r0 * scale, r1 * scale, r2 * scale
    t0 = dot3(k0, k1, k2, spread(view[0]), spread(view[1]), spread(view[2]))
    t1 = dot3(k0, k1, k2, spread(view[4]), spread(view[5]), spread(view[6]))
    t2 = dot3(k0, k1, k2, spread(view[8]), spread(view[9]), spread(view[10]))
    return t0, t1, t2, fma(j02, t2, j00 * t0), fma(j12, t2, j11 * t1)


@_inline
def _white(axis, whitening):
    """Return a projected axis in the whitened coordinates t and s; ``whitening`` is (L00, L01, L11)."""
    l00, l01, l11 = whitening
    return fma(l00, axis[3], l01 * axis[4]), l11 * axis[4]


@_inline
def _add_lens(e0, e1, axis, whitening, by_j):
    """Add the derivatives by J00, J02, J11 and J12 through one axis to ``by_j``.

    They are 2 S b, where S b = L^T e / 2 with e = (e0, e1) and the whitening matrix L.
    """
    l00, l01, l11 = whitening
    by_b0, by_b1 = l00 * e0, fma(l01, e0, l11 * e1)
    return (
        fma(by_b0, axis[0], by_j[0]), fma(by_b0, axis[2], by_j[1]),
        fma(by_b1, axis[1], by_j[2]), fma(by_b1, axis[2], by_j[3]),
    )  # fmt: skip


@_inline
def _to_world(x, y, z, view):
    return (
        fma(z, view[8], fma(y, view[4], x * view[0])), fma(z, view[9], fma(y, view[5], x * view[1])),
        fma(z, view[10], fma(y, view[6], x * view[2])),
    )  # fmt: skip


@_inline
def _point_by_lens(by_j, point, lens_slopes, view):
    """Return the derivative by the point in the camera frame, through the projection's Jacobian only, in world axes."""
    j00, j02, j11, j12 = by_j
    f_x, f_y, inside_x, inside_y = point
    slope_x, slope_y = lens_slopes
    moved_x, moved_y = sel(inside_x, f_x * j02, F(0.0)), sel(inside_y, f_y * j12, F(0.0))
    by_z = fma(slope_x, fma(f_x, j02, moved_x), slope_y * fma(f_y, j12, moved_y))
    return _to_world(neg(moved_x), neg(moved_y), by_z - fma(f_x, j00, f_y * j11), view)


@_inline
def _times_moments(a, m):
    """Return the product of the 5 x 5 matrix of moments of (t, s, tt, ts, ss), given by ``m``, and vector ``a`` [5]."""
    return (
        fma(a[4], m[8], fma(a[3], m[7], fma(a[2], m[6], fma(a[1], m[4], a[0] * m[3])))),
        fma(a[4], m[9], fma(a[3], m[8], fma(a[2], m[7], fma(a[1], m[5], a[0] * m[4])))),
        fma(a[4], m[12], fma(a[3], m[11], fma(a[2], m[10], fma(a[1], m[7], a[0] * m[6])))),
        fma(a[4], m[13], fma(a[3], m[12], fma(a[2], m[11], fma(a[1], m[8], a[0] * m[7])))),
        fma(a[4], m[14], fma(a[3], m[13], fma(a[2], m[12], fma(a[1], m[9], a[0] * m[8])))),
    )


@_inline
def _dot5(a, b):
    return fma(a[4], b[4], fma(a[3], b[3], fma(a[2], b[2], fma(a[1], b[1], a[0] * b[0]))))


@_inline
def _dot_curved(a, b):
    """Return the dot product of (0, 0, *a) and ``b`` [5]; ``a`` [3] has no t and s, as log-scales move no mean."""
    return fma(a[2], b[4], fma(a[1], b[3], a[0] * b[2]))


@_inline
def _times_curved(a, m):
    """Return the product of the 3 x 3 matrix of moments of (tt, ts, ss), given by ``m``, and vector ``a`` [3]."""
    return (
        fma(a[2], m[12], fma(a[1], m[11], a[0] * m[10])), fma(a[2], m[13], fma(a[1], m[12], a[0] * m[11])),
        fma(a[2], m[14], fma(a[1], m[13], a[0] * m[12])),
    )  # fmt: skip


@_inner
def _chain_block(parameters, i, view, grid, records, sums_of, result):
    """Compute the blocks of Gaussians i to i + 15 from their summed slots; return the bits of Gaussians with a weight.

    ``sums_of [2 * 256]`` holds the moments, then the other sums, and is overwritten. ``result [count, 32]`` is the
    output.
    """
    capacity = grid[layout.CAPACITY]
    m = load_sums(sums_of, 0)
    seen = m[15] > F(0.0)
    if bits(seen) == 0:
        return np.int64(0)
    n = load_sums(sums_of, LANES * LANES)
    record = load_transposed(records, layout.RECORD * i)
    l00, l01, l11 = sel(seen, record[layout.L00], F(0.0)), sel(seen, record[layout.L01], F(0.0)), record[layout.L11]
    l11 = sel(seen, l11, F(0.0))
    whitening = (l00, l01, l11)
    x, y, z = projection.camera_point(parameters, capacity, i, view)
    z = larger(z, spread(layout.NEAR_PLANE))
    inverse_z = spread(F(1.0)) / z
    j00, j02, j11, j12, slope_x, slope_y = projection.jacobian_of(x, y, inverse_z, view)
    lens, square = (j00, j02, j11, j12), inverse_z * inverse_z
    point = (
        square * view[layout.FX], square * view[layout.FY],
        (x * inverse_z >= view[layout.LOW_X]) & (x * inverse_z <= view[layout.HIGH_X]),
        (y * inverse_z >= view[layout.LOW_Y]) & (y * inverse_z <= view[layout.HIGH_Y]),
    )  # fmt: skip
    _, _, r = projection.rotation_of(parameters, capacity, i)
    axis0 = _axis(r[0], r[3], r[6], projection.scale_of(parameters, capacity, i, np.int64(0)), lens, view)
    axis1 = _axis(r[1], r[4], r[7], projection.scale_of(parameters, capacity, i, np.int64(1)), lens, view)
    axis2 = _axis(r[2], r[5], r[8], projection.scale_of(parameters, capacity, i, np.int64(2)), lens, view)
    p0, r0 = _white(axis0, whitening)
    p1, r1 = _white(axis1, whitening)
    p2, r2 = _white(axis2, whitening)
    zero = spread(F(0.0))
    nothing, four, slopes = (zero, zero, zero, zero), layout.LN_4 * layout.LN_4, (slope_x, slope_y)
    # Coefficients of the derivatives by the mean. First of t and s, through the projected mean:
    f_x, f_y = point[0], point[1]
    u_t, v_t, v_s = l00 * layout.LN_4, l01 * layout.LN_4, l11 * layout.LN_4
    of_t = _to_world(j00 * u_t, j11 * v_t, neg(fma(f_x * x, u_t, f_y * y * v_t)), view)
    of_s = _to_world(zero, j11 * v_s, neg(f_y * y * v_s), view)
    # Then of t^2, t s and s^2, through the Jacobian of the projection:
    by_j = _add_lens(p0, zero, axis0, whitening, nothing)
    by_j = _add_lens(p1, zero, axis1, whitening, by_j)
    of_tt = _point_by_lens(_add_lens(p2, zero, axis2, whitening, by_j), point, slopes, view)
    by_j = _add_lens(r0, p0, axis0, whitening, nothing)
    by_j = _add_lens(r1, p1, axis1, whitening, by_j)
    of_ts = _point_by_lens(_add_lens(r2, p2, axis2, whitening, by_j), point, slopes, view)
    by_j = _add_lens(zero, r0, axis0, whitening, nothing)
    by_j = _add_lens(zero, r1, axis1, whitening, by_j)
    of_ss = _point_by_lens(_add_lens(zero, r2, axis2, whitening, by_j), point, slopes, view)
    a0 = (of_t[0], of_s[0], of_tt[0] * four, of_ts[0] * four, of_ss[0] * four)
    a1 = (of_t[1], of_s[1], of_tt[1] * four, of_ts[1] * four, of_ss[1] * four)
    a2 = (of_t[2], of_s[2], of_tt[2] * four, of_ts[2] * four, of_ss[2] * four)
    c0 = (p0 * p0 * four, (p0 + p0) * r0 * four, r0 * r0 * four)
    c1 = (p1 * p1 * four, (p1 + p1) * r1 * four, r1 * r1 * four)
    c2 = (p2 * p2 * four, (p2 + p2) * r2 * four, r2 * r2 * four)
    b0, b1, b2 = _times_moments(a0, m), _times_moments(a1, m), _times_moments(a2, m)
    d0, d1, d2 = _times_curved(c0, m), _times_curved(c1, m), _times_curved(c2, m)
    _, complement, _ = projection.opacity_of(parameters, capacity, i)
    store_transposed(
        sums_of, 0,
        (
            _dot5(a0, b0), _dot5(a1, b0), _dot5(a2, b0), _dot_curved(c0, b0), _dot_curved(c1, b0), _dot_curved(c2, b0),
            _dot5(a1, b1), _dot5(a2, b1), _dot_curved(c0, b1), _dot_curved(c1, b1), _dot_curved(c2, b1),
            _dot5(a2, b2), _dot_curved(c0, b2), _dot_curved(c1, b2), _dot_curved(c2, b2),
            dot3(c0[0], c0[1], c0[2], d0[0], d0[1], d0[2]),
        ),
    )  # fmt: skip
    store_transposed(
        sums_of, LANES * LANES,
        (
            dot3(c1[0], c1[1], c1[2], d0[0], d0[1], d0[2]), dot3(c2[0], c2[1], c2[2], d0[0], d0[1], d0[2]),
            dot3(c1[0], c1[1], c1[2], d1[0], d1[1], d1[2]), dot3(c2[0], c2[1], c2[2], d1[0], d1[1], d1[2]),
            dot3(c2[0], c2[1], c2[2], d2[0], d2[1], d2[2]),
            complement * complement * m[0], n[SQUARED], m[15], n[TOUCHES], n[GATHERED],
        ),
    )  # fmt: skip
    for lane in range(LANES):
        row = RESULT_FLOATS * (i + lane)
        store(result, row, load(sums_of, LANES * lane))
        store(result, row + LANES, load(sums_of, LANES * (LANES + lane)))
    return bits(seen)


@_inner
def _chain_chunk(number, parameters, lists, slots, sums_of, result):
    """Sum the slots of the 1024 Gaussians of chunk ``lists.taken[number]``, and compute their blocks.

    ``visible`` then has a bit for each Gaussian with a row in ``result``.
    """
    view, grid, records, visible = lists.camera, lists.grid, lists.records, lists.visible
    zero, chunk = spread(F(0.0)), lists.taken[number]
    for i in range(chunk * layout.CHUNK, min((chunk + 1) * layout.CHUNK, grid[layout.COUNT]), LANES):
        seen = np.int64(peek(visible, i // LANES))
        if seen == 0:
            continue
        for lane in range(LANES):
            first, second = zero, zero
            if (seen >> lane) & 1:
                base = layout.RECORD * (i + lane)
                slot = peek_bits(records, base + layout.SLOT)
                for at in range(slot, slot + peek_bits(records, base + layout.SLOTS)):
                    first = first + load(slots, SLOT_FLOATS * at)
                    second = second + load(slots, SLOT_FLOATS * at + LANES)
            store(sums_of, LANES * lane, first)
            store(sums_of, LANES * (LANES + lane), second)
        seen = _chain_block(parameters, i, view, grid, records, sums_of, result)
        poke(visible, i // LANES, np.int32(seen))


@kernel
def inform(tickets, parameters, lists, scratch, asked, pictures, told):
    """Compute images and sums over pixels tile by tile, then the information block of each Gaussian chunk by chunk.

    `kernels.prepare` must have run before. ``asked`` (`Asked`) is input. The images of colour, depth and alpha are
    written to ``pictures``, and all other results to ``told`` (`Told`).
    """
    own = LANES * take_ticket(tickets, THREAD_TICKET) * (layout.SCRATCH // LANES)
    state, kept = scratch[own : own + _STATE], scratch[own + _STATE : own + layout.SCRATCH]
    grid, tile_order, width, pixel_values, slots = (
        lists.grid, lists.tile_order, asked.width, asked.pixel_values, told.slots
    )  # fmt: skip
    digits, tiles = np.empty(layout.DIGITS, np.int64), grid[layout.TILES_X] * grid[layout.TILES_Y]
    painted, no_light = scratch_of(64 * LANES * width + LANES), spread(F(0.0))
    while True:
        ticket = take_ticket(tickets, 2)
        if ticket >= tiles:
            break
        tile = tile_order[ticket]
        blocks = tile_lists.sort_tile(tile, lists, digits)
        if LANES * blocks > len(kept):
            kept = scratch_of(LANES * (blocks + blocks // 4))
        alive = blending.open_tile(tile, grid, state, np.int64(blending.COLORED_STATE))
        done = blending.blend_forward(tile, alive, lists, state, kept, np.int64(LANES))
        blending.write_tile(tile, grid, state, pictures)
        _turn_back(state, tile, grid, pixel_values)
        for at in range(0, 64 * LANES * width, LANES):
            store(painted, at, no_light)
        _sum_tile(tile, done, lists, state, kept, asked, painted, slots)
        if width != 0:
            _write_channels(tile, grid, painted, width, told.pictures)
        take_ticket(tickets, TILES_DONE)
    if not all_done(tickets, TILES_DONE, tiles):
        return
    sums_of = scratch[own : own + layout.SCRATCH]
    while True:
        number = take_ticket(tickets, 6)
        if number >= len(lists.taken):
            return
        _chain_chunk(number, parameters, lists, slots, sums_of, told.numbers)
        take_ticket(tickets, STEPPED)
