"""Compute pixelwise losses of a tile between blending and the backward pass, while its pixels are in the cache."""

# mypy: ignore-errors
# (the arguments of kernels have numba's types, and intrinsics are called without their typing context)

from __future__ import annotations

from activestructure_gym.splatting.blending import COLORED_STATE, corner_of
from activestructure_gym.splatting.elementary import larger
from activestructure_gym.splatting.layout import HEIGHT, TILE_BLOCKS, WIDTH
from activestructure_gym.splatting.memory import load, load_block, load_color_block, peek, poke, store
from activestructure_gym.splatting.simd import LANES, F, fma, inline, inner, neg, sel, spread

# Factors of the losses: of |colour difference|, of SSIM, of |depth error|, and twice the factor of (1 - alpha)^2. Then
# the minimum alpha of a pixel whose depth is compared. NORMALISED: 1 to compare depth / alpha, 0 to compare accumulated
# depth.
OF_COLOR, OF_SSIM, OF_DEPTH, OF_ALPHA, MIN_ALPHA, NORMALISED, FACTORS = range(7)
# Offsets of the sums of a tile, 16 lanes each: |colour difference| and |depth error|.
TILE_COLOR, TILE_DEPTH, TILE_TERMS = 0, LANES, 2 * LANES


@inline
def absolute_difference(value, target, weight):
    """Return |value - target|, and its derivative times ``weight``."""
    difference = value - target
    return larger(difference, neg(difference)), sel(
        difference > F(0.0), weight, sel(difference < F(0.0), neg(weight), F(0.0))
    )


@inner
def compare_tile(tile, grid, state, comparison, edge):
    """Compare a blended tile with the target, and convert its state to the initial state of the backward loop.

    ``comparison`` is an `arguments.Comparison`. ``edge [64]`` is workspace for a block at the border of the image.
    """
    target, target_depth, factors, terms = comparison
    x, y = corner_of(tile, grid)
    width, one = grid[WIDTH], spread(F(1.0))
    color_sum, depth_sum, of_color = spread(F(0.0)), spread(F(0.0)), spread(factors[OF_COLOR])
    for block in range(grid[TILE_BLOCKS]):
        left, top, at = x + 4 * (block & 7), y + 4 * (block >> 3), COLORED_STATE * block
        if left >= width or top >= grid[HEIGHT]:
            continue
        pixel = top * width + left
        if left + 4 <= width and top + 4 <= grid[HEIGHT]:
            red, green, blue = load_color_block(target, 3 * pixel, 3 * width)
            measured = load_block(target_depth, pixel, width)
        else:
            for k in range(0, 64, LANES):
                store(edge, k, spread(F(0.0)))
            for row in range(min(4, grid[HEIGHT] - top)):
                for column in range(min(4, width - left)):
                    here = pixel + row * width + column
                    for channel in range(3):
                        poke(edge, 12 * row + 3 * column + channel, peek(target, 3 * here + channel))
                    poke(edge, 48 + 4 * row + column, peek(target_depth, here))
            red, green, blue = load_color_block(edge, 0, 12)
            measured = load(edge, 48)
        rest, z = load(state, at), load(state, at + 16)
        r, g, b = load(state, at + 32), load(state, at + 48), load(state, at + 64)
        left_over = larger(rest, neg(rest))
        opaque = one - left_over
        has_depth = measured > F(0.0)
        counts = has_depth & (opaque > factors[MIN_ALPHA])
        # Outside the image colours and targets are 0, and so are all values computed from them.
        error_r, g_r = absolute_difference(r, red, of_color)
        error_g, g_g = absolute_difference(g, green, of_color)
        error_b, g_b = absolute_difference(b, blue, of_color)
        color_sum = color_sum + (error_r + error_g + error_b)
        share = sel(counts & (spread(factors[NORMALISED]) > F(0.0)), opaque, F(1.0))
        expected = z / share
        error, g_z = absolute_difference(expected, measured, spread(factors[OF_DEPTH]))
        depth_sum = depth_sum + sel(counts, error, F(0.0))
        g_z = sel(counts, g_z / share, F(0.0))
        g_a = neg(sel(has_depth, left_over * factors[OF_ALPHA], F(0.0)))
        g_a = g_a - g_z * expected * factors[NORMALISED]
        total = fma(r, g_r, fma(g, g_g, fma(b, g_b, fma(z, g_z, opaque * g_a))))
        store(state, at, sel(rest > F(-1.0), one, neg(one)))  # -1 marks positions outside the image
        store(state, at + 16, total)
        store(state, at + 32, g_r)
        store(state, at + 48, g_g)
        store(state, at + 64, g_b)
        store(state, at + 80, g_z)
        store(state, at + 96, g_a)
    store(terms, TILE_TERMS * tile + TILE_COLOR, color_sum)
    store(terms, TILE_TERMS * tile + TILE_DEPTH, depth_sum)
