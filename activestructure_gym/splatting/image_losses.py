"""Compute losses of whole images: colour with SSIM, and depth.

A colour image is stored in rows of STRIDE floats: MARGIN zeros, the pixels with interleaved channels, zeros. So a
horizontal blur of one channel has steps of three floats.

A thread processes a strip of the image: a few columns of vectors of 16 floats, over all rows. It takes 8 rows at a
time, a group. Each group is blurred horizontally first. It is blurred vertically once the groups above and below it
have been blurred horizontally. One load of a row then serves up to 8 sums.

In the following, x is the rendered image, y the target, u = (x + y) / sqrt(2) and v = (x - y) / sqrt(2). The blurs of
u^2 and v^2 give all second moments that SSIM needs, so no product x y is stored. The data between the steps remain in
the second-level cache:

- lines: u and v of one row;
- means: the last 3 groups of u, u^2, v and v^2, blurred horizontally, [column, (u, u^2, v, v^2), row, 16];
- maps: 1 group of the derivatives of SSIM by mean, variance and covariance, [derivative, row, column, 16];
- backs: the last 3 groups of these derivatives, blurred horizontally, [column, derivative, row, 16].
"""

# mypy: ignore-errors
# (the arguments of kernels have numba's types, and intrinsics are called without their typing context)

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from activestructure_gym.splatting.layout import HEIGHT, MARGIN, STRIDE, WIDTH
from activestructure_gym.splatting.memory import load, pointer_to, store
from activestructure_gym.splatting.simd import (
    F32,
    FLOATS,
    I32,
    I64,
    INTS,
    LANES,
    MASK,
    F,
    call_llvm,
    floats,
    fma,
    inline,
    inner,
    lane_index,
    neg,
    sel,
    spread,
    spread_value,
)
from activestructure_gym.splatting.tile_losses import (
    MIN_ALPHA,
    NORMALISED,
    OF_ALPHA,
    OF_COLOR,
    OF_DEPTH,
    OF_SSIM,
    absolute_difference,
)

_HALF_TAPS = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
_TAPS = (_HALF_TAPS / _HALF_TAPS.sum()).astype(np.float32)
_C1, _C2, _ROOT = F(0.01**2), F(0.03**2), F(np.sqrt(0.5))  # constants of SSIM for colours in 0..1, and 1 / sqrt(2)
GROUP_ROWS = 8  # rows per group
GROUP_FLOATS = GROUP_ROWS * LANES  # floats of one quantity in one column of a group
# Offsets of partial sums: per column of vectors, 16 lanes each, |colour difference| and SSIM. After all columns, the
# sum of |depth error| of each piece of the depth image.
TERM_COLOR, TERM_SSIM, TERMS = 0, LANES, 2 * LANES
PIECE = 1920  # pixels per piece of the depth image
# Floats of workspace per column of a strip; four more columns are needed for its edges.
STRIP_FLOATS = (3 * 4 + 3 * 3 + 3) * GROUP_FLOATS + 2 * LANES


class Strip(NamedTuple):
    """Hold the columns of vectors that a thread processes, and the offsets of its data in the workspace."""

    first: int  # first column
    last: int  # last column, exclusive
    lines: int  # offset of the lines
    blurred: int  # offset of the space for one column of a group, blurred vertically
    maps: int  # offset of the maps


class Around(NamedTuple):
    """Hold the offsets in the workspace of a quantity in three consecutive groups of rows."""

    above: int
    here: int
    below: int


def _load_at(context, builder, sig, args, offset):
    pointer = pointer_to(context, builder, sig.args[0], args[0], builder.add(args[1], ir.Constant(I64, offset)))
    return builder.load(builder.bitcast(pointer, FLOATS.as_pointer()), align=4, typ=FLOATS)


def _taps(builder):
    """Return the weights of the blur by distance from the pixel, 0 to 5, each in all lanes of a vector.

    Each vector is built once from one number and used for all sums. Written as literals at every use, the vectors would
    be most of the code that LLVM has to read.
    """
    return [spread_value(builder, ir.Constant(F32, float(tap))) for tap in _TAPS[5:]]


def _fused(builder, a, b, c):
    return call_llvm(builder, "llvm.fmuladd.v16f32", FLOATS, [a, b, c])


@intrinsic
def _blur_along(typingctx, array, index):
    """Blur horizontally at the 16 floats of ``array`` from ``index`` on."""

    def codegen(context, builder, sig, args):
        taps = _taps(builder)
        total = builder.fmul(_load_at(context, builder, sig, args, 0), taps[0])
        for k in range(1, 6):
            pair = [_load_at(context, builder, sig, args, offset) for offset in (-3 * k, 3 * k)]
            total = _fused(builder, builder.fadd(*pair), taps[k], total)
        return total

    return floats(array, types.intp), codegen


@intrinsic
def _blur_squares_along(typingctx, array, index):
    """Blur the 16 floats from ``index`` on, and their squares, horizontally; return both results."""

    def codegen(context, builder, sig, args):
        taps, value = _taps(builder), _load_at(context, builder, sig, args, 0)
        total, squares = builder.fmul(value, taps[0]), builder.fmul(builder.fmul(value, value), taps[0])
        for k in range(1, 6):
            one, two = (_load_at(context, builder, sig, args, offset) for offset in (-3 * k, 3 * k))
            total = _fused(builder, builder.fadd(one, two), taps[k], total)
            squares = _fused(builder, _fused(builder, one, one, builder.fmul(two, two)), taps[k], squares)
        return context.make_tuple(builder, sig.return_type, [total, squares])

    return types.UniTuple(floats, 2)(array, types.intp), codegen


@intrinsic
def _blur_down(typingctx, array, above, here, below, to):
    """Blur a group of 8 rows vertically, and store the result at offset ``to``.

    ``above``, ``here`` and ``below`` are the offsets of three consecutive groups in ``array``.
    """

    def codegen(context, builder, sig, args):
        taps, totals = _taps(builder), [None] * GROUP_ROWS
        for row in range(-5, GROUP_ROWS + 5):
            block = [args[0], args[2 + (row >= GROUP_ROWS) - (row < 0)]]
            value = _load_at(context, builder, sig, block, LANES * (row % GROUP_ROWS))
            for to in range(max(row - 5, 0), min(row + 6, GROUP_ROWS)):
                tap = taps[abs(row - to)]
                totals[to] = builder.fmul(value, tap) if row == to - 5 else _fused(builder, value, tap, totals[to])
        for row, total in enumerate(totals):
            at = builder.add(args[4], ir.Constant(I64, LANES * row))
            pointer = pointer_to(context, builder, sig.args[0], args[0], at)
            builder.store(total, builder.bitcast(pointer, FLOATS.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, *[types.intp] * 4), codegen


def _first_lanes(builder, count):
    lanes = ir.Constant(INTS, list(range(LANES)))
    return builder.icmp_signed("<", lanes, spread_value(builder, builder.trunc(count, I32)))


@intrinsic
def _load_first(typingctx, array, index, count):
    """Load the first ``count`` of 16 floats, and zeros for the others, whose memory is not accessed."""

    def codegen(context, builder, sig, args):
        pointer = builder.bitcast(pointer_to(context, builder, sig.args[0], args[0], args[1]), FLOATS.as_pointer())
        mask = _first_lanes(builder, args[2])
        kind = ir.FunctionType(FLOATS, [pointer.type, I32, MASK, FLOATS])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.masked.load.v16f32.p0")
        return builder.call(function, [pointer, ir.Constant(I32, 4), mask, ir.Constant(FLOATS, None)])

    return floats(array, types.intp, types.intp), codegen


@intrinsic
def _store_first(typingctx, array, index, count, value):
    def codegen(context, builder, sig, args):
        pointer = builder.bitcast(pointer_to(context, builder, sig.args[0], args[0], args[1]), FLOATS.as_pointer())
        kind = ir.FunctionType(ir.VoidType(), [FLOATS, pointer.type, I32, MASK])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.masked.store.v16f32.p0")
        builder.call(function, [args[3], pointer, ir.Constant(I32, 4), _first_lanes(builder, args[2])])
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, floats), codegen


@inline
def _load_up_to(array, at, end):
    """Load 16 floats, with zeros from index ``end`` on."""
    return load(array, at) if at + LANES <= end else _load_first(array, at, end - at)


@inline
def _store_up_to(array, at, end, value):
    if at + LANES <= end:
        store(array, at, value)
    else:
        _store_first(array, at, end - at, value)


@inline
def _load_target(target, row, column, length):
    """Load 16 floats of a row of ``target [H, length]``, with zeros after the end of the row."""
    return _load_up_to(target, row * length + LANES * column, (row + 1) * length)


@inner
def clear(array, first, end):
    """Set the floats from index ``first`` to ``end`` of an array to 0, 16 at a time."""
    for at in range(first, end, LANES):
        store(array, at, spread(F(0.0)))


@inner
def means_of_group(top, strip, grid, image, target, scratch, means):
    """Blur u, u^2, v and v^2 of the group of rows from ``top`` on horizontally; write them at offset ``means``.

    ``strip`` is the `Strip` of the thread; u and v are computed from ``image`` and ``target``.
    """
    first, last, lines = strip.first, strip.last, strip.lines
    stride, length, height = grid[STRIDE], 3 * grid[WIDTH], grid[HEIGHT]
    columns = (length + LANES - 1) // LANES
    room = last - first + 4
    low, high = max(first - 1, 0), min(last + 1, columns)
    for row in range(top, min(top + GROUP_ROWS, height)):
        base = row * stride + grid[MARGIN]
        for column in range(max(first - 2, 0), min(last + 2, columns)):
            x, y = load(image, base + LANES * column), _load_target(target, row, column, length)
            at = lines + LANES * (column - first + 2)
            store(scratch, at, (x + y) * _ROOT)
            store(scratch, at + LANES * room, (x - y) * _ROOT)
        for column in range(low, high):
            at = lines + LANES * (column - first + 2)
            mean_u, square_u = _blur_squares_along(scratch, at)
            mean_v, square_v = _blur_squares_along(scratch, at + LANES * room)
            to = means + 4 * GROUP_FLOATS * (column - first + 1) + LANES * (row - top)
            store(scratch, to, mean_u)
            store(scratch, to + GROUP_FLOATS, square_u)
            store(scratch, to + 2 * GROUP_FLOATS, mean_v)
            store(scratch, to + 3 * GROUP_FLOATS, square_v)
    for row in range(max(height - top, 0), GROUP_ROWS):
        for to in range(means + LANES * row, means + 4 * GROUP_FLOATS * (last - first + 2), GROUP_FLOATS):
            store(scratch, to, spread(F(0.0)))


@inner
def maps_of_group(top, strip, grid, scratch, means, backs, terms):
    """Compute SSIM in the group of rows from ``top`` on: its sum, and its derivatives, blurred horizontally.

    ``strip`` is the `Strip` of the thread, and ``means`` has the offsets of the blurred quantities. The sum is added to
    ``terms``, and the derivatives are written at offset ``backs``.
    """
    first, last, blurred, maps = strip.first, strip.last, strip.blurred, strip.maps
    above, here, below = means
    length, zero = 3 * grid[WIDTH], spread(F(0.0))
    line = LANES * (last - first + 2)  # floats of a row of the maps: columns of the strip and one on each side
    plane = GROUP_ROWS * line
    for column in range(max(first - 1, 0), last + 2):
        # The derivatives are blurred two columns later, alternating with SSIM row by row. So the arithmetic of SSIM
        # overlaps with their loads across cache lines, and loads do not meet stores.
        total = zero
        if column <= last:
            for own in range(0, 4 * GROUP_FLOATS, GROUP_FLOATS):
                at = 4 * GROUP_FLOATS * (column - first + 1) + own
                _blur_down(scratch, above + at, here + at, below + at, blurred + own)
        for row in range(GROUP_ROWS):
            at = maps + row * line + LANES * (column - first + 1)
            if column <= last:
                own = blurred + LANES * row
                mu, mv = load(scratch, own), load(scratch, own + 2 * GROUP_FLOATS)
                mu_mu, mv_mv = mu * mu, mv * mv
                var_u, var_v = load(scratch, own + GROUP_FLOATS) - mu_mu, load(scratch, own + 3 * GROUP_FLOATS) - mv_mv
                n1, n2 = mu_mu - mv_mv + _C1, var_u - var_v + _C2
                d1, d2 = mu_mu + mv_mv + _C1, var_u + var_v + _C2
                inverse = spread(F(1.0)) / (d1 * d2)
                value = n1 * n2 * inverse
                mx, my = mu + mv, mu - mv  # both times sqrt(2)
                by_mean = fma(my, n2 - n1, mx * value * (d1 - d2)) * inverse * (F(2.0) * _ROOT)
                inside = lane_index() < F(length - LANES * column if top + row < grid[HEIGHT] else 0)
                total = total + sel(inside, value, F(0.0))
                store(scratch, at, sel(inside, by_mean, F(0.0)))
                store(scratch, at + plane, sel(inside, neg(value * d1 * inverse), F(0.0)))
                store(scratch, at + 2 * plane, sel(inside, n1 * inverse * F(2.0), F(0.0)))
            if column - 2 >= first:
                at, to = at - 2 * LANES, backs + 3 * GROUP_FLOATS * (column - 2 - first) + LANES * row
                store(scratch, to, _blur_along(scratch, at))
                store(scratch, to + GROUP_FLOATS, _blur_along(scratch, at + plane))
                store(scratch, to + 2 * GROUP_FLOATS, _blur_along(scratch, at + 2 * plane))
        if column >= first and column < last:
            at = TERMS * column + TERM_SSIM
            store(terms, at, load(terms, at) + total)


@inner
def gradient_of_group(top, strip, grid, image, comparison, scratch, backs, by_color):
    """Compute the gradient by the colours in the group of rows from ``top`` on, and the sum of |colour difference|.

    ``strip`` is the `Strip` of the thread, and ``backs`` has the offsets of the derivatives of SSIM. The gradient is
    written to ``by_color``.
    """
    first, last, blurred = strip.first, strip.last, strip.blurred
    above, here, below = backs
    target, factors, terms = comparison.color, comparison.factors, comparison.terms
    stride, length = grid[STRIDE], 3 * grid[WIDTH]
    of_sign, of_ssim = factors[OF_COLOR], factors[OF_SSIM]
    for column in range(first, last):
        for quantity in range(0, 3 * GROUP_FLOATS, GROUP_FLOATS):
            own = 3 * GROUP_FLOATS * (column - first) + quantity
            _blur_down(scratch, above + own, here + own, below + own, blurred + quantity)
        inside, total = lane_index() < F(length - LANES * column), spread(F(0.0))
        for row in range(top, min(top + GROUP_ROWS, grid[HEIGHT])):
            at, own = row * stride + grid[MARGIN] + LANES * column, blurred + LANES * (row - top)
            x, y = load(image, at), _load_target(target, row, column, length)
            error, gradient = absolute_difference(x, y, spread(of_sign))
            total = total + error
            by_variance, by_covariance = load(scratch, own + GROUP_FLOATS), load(scratch, own + 2 * GROUP_FLOATS)
            of_both = fma(x + x, by_variance, fma(y, by_covariance, load(scratch, own)))
            store(by_color, at, sel(inside, fma(of_both, of_ssim, gradient), F(0.0)))
        at = TERMS * column + TERM_COLOR
        store(terms, at, load(terms, at) + total)  # both are 0 after the end of the row


@inner
def compare_depth(first, end, pictures, comparison, by_pictures):
    """Return the sum of the depth errors of pixels ``first`` to ``end``; write the derivatives by depth and alpha."""
    depth, alpha, by_depth, by_alpha = pictures.depth, pictures.alpha, by_pictures.depth, by_pictures.alpha
    target_depth, factors = comparison.depth, comparison.factors
    total, one = spread(F(0.0)), spread(F(1.0))
    normalised = spread(factors[NORMALISED]) > F(0.0)
    for at in range(first, end, LANES):
        measured, opaque = _load_up_to(target_depth, at, end), _load_up_to(alpha, at, end)
        has_depth = measured > F(0.0)
        counts = has_depth & (opaque > factors[MIN_ALPHA])
        of_sum = one / sel(counts & normalised, opaque, F(1.0))
        expected = _load_up_to(depth, at, end) * of_sum
        error, sign = absolute_difference(expected, measured, spread(factors[OF_DEPTH]))
        total = total + sel(counts, error, F(0.0))
        g_z = sel(counts, sign * of_sum, F(0.0))
        _store_up_to(by_depth, at, end, g_z)
        g_a = sel(has_depth, (opaque - F(1.0)) * factors[OF_ALPHA], F(0.0))
        _store_up_to(by_alpha, at, end, g_a - g_z * expected * factors[NORMALISED])
    return total
