"""Project Gaussians to ellipses in the image, 16 at a time, into records of 64 bytes (`layout`).

A value of 16 Gaussians is one vector. ``i`` is the column of the first, ``capacity`` the number of columns of
``parameters``, and ``view`` holds the camera.
"""

# mypy: ignore-errors
# (the arguments of kernels have numba's types, and intrinsics are called without their typing context)

from __future__ import annotations

import numpy as np

from activestructure_gym.splatting.elementary import clamped, dot3, exp2, larger, log2_of, smaller
from activestructure_gym.splatting.layout import (
    BLOCKS_X,
    BLOCKS_Y,
    BLUR,
    CAPACITY,
    COUNT,
    CX,
    CY,
    FX,
    FY,
    HEIGHT,
    HIGH_X,
    HIGH_Y,
    LOG2_255,
    LOG2_E,
    LOW_X,
    LOW_Y,
    NEAR_PLANE,
    RECORD,
    ROOT,
    SLACK,
    SLANT,
    SLANT_VARIANCE,
    WIDTH,
)
from activestructure_gym.splatting.memory import load, store_transposed
from activestructure_gym.splatting.simd import (
    F,
    bits,
    ceil,
    float_bits,
    floor,
    fma,
    inline,
    inner,
    int_bits,
    lane_index,
    neg,
    sel,
    spread,
    sqrt,
    to_int,
)


@inline
def camera_point(parameters, capacity, i, view):
    """Return the means of 16 Gaussians in the camera frame, in metres."""
    return _seen_from(
        load(parameters, i), load(parameters, capacity + i), load(parameters, 2 * capacity + i), view
    )  # fmt: skip


@inline
def _seen_from(mx, my, mz, view):
    x = fma(mz, view[2], fma(my, view[1], fma(mx, view[0], view[3])))
    y = fma(mz, view[6], fma(my, view[5], fma(mx, view[4], view[7])))
    z = fma(mz, view[10], fma(my, view[9], fma(mx, view[8], view[11])))
    return x, y, z


@inline
def scale_of(parameters, capacity, i, axis):
    """Return the standard deviation of 16 Gaussians along one of their axes in metres, limited to 2^-60 .. 2^60."""
    return exp2(clamped(load(parameters, (7 + axis) * capacity + i) * LOG2_E, spread(F(-60.0)), spread(F(60.0))))


@inline
def rotation_of(parameters, capacity, i):
    """Return unit quaternions of 16 Gaussians, the inverse of their original lengths, and the matrices (9 entries)."""
    w, x = load(parameters, 3 * capacity + i), load(parameters, 4 * capacity + i)
    y, z = load(parameters, 5 * capacity + i), load(parameters, 6 * capacity + i)
    inverse = spread(F(1.0)) / sqrt(fma(w, w, fma(x, x, fma(y, y, z * z))))
    w, x, y, z = w * inverse, x * inverse, y * inverse, z * inverse
    x2, y2, z2 = x + x, y + y, z + z
    one = spread(F(1.0))
    matrix = (
        one - fma(y, y2, z * z2), fma(x, y2, neg(w * z2)), fma(x, z2, w * y2),
        fma(x, y2, w * z2), one - fma(x, x2, z * z2), fma(y, z2, neg(w * x2)),
        fma(x, z2, neg(w * y2)), fma(y, z2, w * x2), one - fma(x, x2, y * y2),
    )  # fmt: skip
    return (w, x, y, z), inverse, matrix


@inline
def jacobian_of(x, y, inverse_z, view):
    """Return the entries J00, J02, J11, J12 of the projection's Jacobian, and the clamped slopes x / z and y / z."""
    slope_x = clamped(x * inverse_z, spread(view[LOW_X]), spread(view[HIGH_X]))
    slope_y = clamped(y * inverse_z, spread(view[LOW_Y]), spread(view[HIGH_Y]))
    j00, j11 = inverse_z * view[FX], inverse_z * view[FY]
    return j00, neg(j00 * slope_x), j11, neg(j11 * slope_y), slope_x, slope_y


@inline
def depth_slopes(p, n, z, view):
    """Return the depth slopes of 16 Gaussians along x and y, in metres per pixel: A^-1 (z.p, z.n).

    They are the slopes of the depth at which rays meet the Gaussian. Also return the determinant of A, the covariance
    in the image with less blur than for rendering. ``p``, ``n`` and ``z`` are the components of the three axes along x
    and y in pixels, and along depth in metres. Cross products avoid cancellation for needle-shaped Gaussians: without
    blur, A^-1 (z.p, z.n) = ((z x n).(p x n), (p x z).(p x n)) / |p x n|^2.
    """
    c, a, b = cross(p, n), cross(z, n), cross(p, z)
    spread_of = dot3(*p, *p) + dot3(*n, *n)
    determinant = fma(spread_of, SLANT_VARIANCE, dot3(*c, *c)) + SLANT_VARIANCE * SLANT_VARIANCE
    factor = spread(view[SLANT]) / determinant
    slope_x = fma(dot3(*z, *p), SLANT_VARIANCE, dot3(*a, *c)) * factor
    return slope_x, fma(dot3(*z, *n), SLANT_VARIANCE, dot3(*b, *c)) * factor, determinant


@inline
def cross(a, b):
    """Return the cross product of two vectors with three components, in each lane."""
    return fma(a[1], b[2], neg(a[2] * b[1])), fma(a[2], b[0], neg(a[0] * b[2])), fma(a[0], b[1], neg(a[1] * b[0]))


@inline
def opacity_of(parameters, capacity, i):
    """Return three values of 16 Gaussians: opacity, 1 - opacity, and log2 of opacity.

    1 - opacity multiplies gradients, so it is computed without cancellation.
    """
    power = load(parameters, 10 * capacity + i) * neg(spread(LOG2_E))
    e = exp2(larger(smaller(power, spread(F(80.0))), spread(F(-80.0))))  # in this order NaN gives opacity 0
    one_more = e + F(1.0)
    opacity = spread(F(1.0)) / one_more
    return opacity, e * opacity, neg(log2_of(one_more))


@inline
def reaches_image(parameters, i, view, grid):
    """Return a mask of Gaussians i to i + 15 that may reach a pixel, by a cheap bound of their extent in the image."""
    capacity = grid[CAPACITY]
    x, y, z = camera_point(parameters, capacity, i, view)
    live = (z >= NEAR_PLANE) & (lane_index() < F(grid[COUNT] - i))
    if bits(live) == 0:
        return live
    inverse_z = spread(F(1.0)) / sel(live, z, F(1.0))
    u, v = fma(x * inverse_z, view[FX], view[CX]), fma(y * inverse_z, view[FY], view[CY])
    j00, j02, j11, j12, _, _ = jacobian_of(x, y, inverse_z, view)
    # 3.34 sigmas of the largest axis times the norm of the Jacobian at the clamped slope.
    log0, log1, log2 = (
        load(parameters, 7 * capacity + i), load(parameters, 8 * capacity + i), load(parameters, 9 * capacity + i)
    )  # fmt: skip
    live = live & (log0 < F(40.0)) & (log1 < F(40.0)) & (log2 < F(40.0))  # False for NaN
    largest = exp2(clamped(larger(log0, larger(log1, log2)) * LOG2_E, spread(F(-60.0)), spread(F(60.0))))
    norm = dot3(j00, j02, j11, j00, j02, j11) + j12 * j12
    reach = sqrt(fma(norm * largest, largest, view[BLUR])) * F(3.34)
    width, height = F(grid[WIDTH]), F(grid[HEIGHT])
    return live & (u + reach > F(0.0)) & (u - reach < width) & (v + reach > F(0.0)) & (v - reach < height)


@inline
def shape_of(parameters, capacity, i):
    """Return camera-independent data of 16 Gaussians in 16 vectors: mean, rotation by rows, scales, log2 of opacity."""
    _, _, r = rotation_of(parameters, capacity, i)
    _, _, log_opacity = opacity_of(parameters, capacity, i)
    return (
        load(parameters, i), load(parameters, capacity + i), load(parameters, 2 * capacity + i),
        r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8],
        scale_of(parameters, capacity, i, np.int64(0)),
        scale_of(parameters, capacity, i, np.int64(1)),
        scale_of(parameters, capacity, i, np.int64(2)),
        log_opacity,
    )  # fmt: skip


@inner
def project_block(parameters, i, view, grid, records):
    """Write the records of Gaussians i to i + 15; return the bits of Gaussians that reach a block of pixels."""
    live, capacity = reaches_image(parameters, i, view, grid), grid[CAPACITY]
    if bits(live) == 0:
        return np.int64(0)
    colors = (
        load(parameters, 11 * capacity + i), load(parameters, 12 * capacity + i), load(parameters, 13 * capacity + i)
    )  # fmt: skip
    return _write_records(live, shape_of(parameters, capacity, i), colors, i, view, grid, records)


@inline
def ellipse_of(live, shape, view):
    """Return the ellipses of 16 Gaussians in the image, from their data by `shape_of`.

    ``live`` is a mask of the Gaussians to project. The first value is this mask without Gaussians that are visible
    nowhere. The second is the upper limit of t^2 + s^2 at visible pixels. Eight fields of the record follow: U, V,
    DEPTH, L00, L01, L11 and both slopes. The last three are the entries xx, xy and yy of the covariance in the image.
    """
    mx, my, mz = shape[0], shape[1], shape[2]
    r = (shape[3], shape[4], shape[5], shape[6], shape[7], shape[8], shape[9], shape[10], shape[11])
    s0, s1, s2, log_opacity = shape[12], shape[13], shape[14], shape[15]
    x, y, z = _seen_from(mx, my, mz, view)
    inverse_z = spread(F(1.0)) / sel(live, z, F(1.0))
    u, v = fma(x * inverse_z, view[FX], view[CX]), fma(y * inverse_z, view[FY], view[CY])
    j00, j02, j11, j12, _, _ = jacobian_of(x, y, inverse_z, view)
    a0, a1, a2 = fma(j02, view[8], j00 * view[0]), fma(j02, view[9], j00 * view[1]), fma(j02, view[10], j00 * view[2])
    b0, b1, b2 = fma(j12, view[8], j11 * view[4]), fma(j12, view[9], j11 * view[5]), fma(j12, view[10], j11 * view[6])
    p0, p1, p2 = (
        dot3(a0, a1, a2, r[0], r[3], r[6]) * s0,
        dot3(a0, a1, a2, r[1], r[4], r[7]) * s1,
        dot3(a0, a1, a2, r[2], r[5], r[8]) * s2,
    )
    n0, n1, n2 = (
        dot3(b0, b1, b2, r[0], r[3], r[6]) * s0,
        dot3(b0, b1, b2, r[1], r[4], r[7]) * s1,
        dot3(b0, b1, b2, r[2], r[5], r[8]) * s2,
    )
    xx, yy = dot3(p0, p1, p2, p0, p1, p2), dot3(n0, n1, n2, n0, n1, n2)
    xy = dot3(p0, p1, p2, n0, n1, n2)
    # |p x n|^2 is used instead of xx yy - xy^2, because it has no cancellation for needle-shaped Gaussians.
    c0, c1, c2 = fma(p1, n2, neg(p2 * n1)), fma(p2, n0, neg(p0 * n2)), fma(p0, n1, neg(p1 * n0))
    determinant = fma(xx + yy, view[BLUR], dot3(c0, c1, c2, c0, c1, c2)) + view[BLUR] * view[BLUR]
    xx, yy = xx + view[BLUR], yy + view[BLUR]
    inside = log_opacity + LOG2_255  # upper limit of t^2 + s^2 at visible pixels
    live = live & (inside >= F(0.0)) & (determinant > F(0.0))
    inside = sel(live, inside, F(0.0))
    one = spread(F(1.0))
    z0, z1, z2 = (
        dot3(r[0], r[3], r[6], view[8], view[9], view[10]) * s0,
        dot3(r[1], r[4], r[7], view[8], view[9], view[10]) * s1,
        dot3(r[2], r[5], r[8], view[8], view[9], view[10]) * s2,
    )
    slope_x, slope_y, _ = depth_slopes((p0, p1, p2), (n0, n1, n2), (z0, z1, z2), view)
    root_yy, root_determinant = sqrt(yy), sqrt(determinant)
    l11 = one / root_yy * ROOT
    l00 = root_yy / root_determinant * ROOT
    l01 = neg(xy) / (root_yy * root_determinant) * ROOT
    live = live & (l00 > F(0.0)) & (l11 > F(0.0))  # False if a covariance overflows
    # The same slopes per t and s. The slope per s is that with the blurred covariance, plus a correction.
    zy = dot3(z0, z1, z2, n0, n1, n2) * view[SLANT]
    slope_t, slope_s = slope_x / l00, fma(slope_y, view[BLUR] - SLANT_VARIANCE, zy) / (root_yy * ROOT)
    return live, inside, u, v, z, l00, l01, l11, slope_t, slope_s, xx, xy, yy


@inline
def _write_records(live, shape, colors, i, view, grid, records):
    """Project 16 Gaussians and write records i to i + 15; return the bits of Gaussians that reach a block of pixels.

    ``live`` is a mask of Gaussians to project, and ``shape`` is from `shape_of`.
    """
    live, inside, u, v, z, l00, l01, l11, slope_t, slope_s, xx, xy, yy = ellipse_of(live, shape, view)
    log_opacity, one = shape[15], spread(F(1.0))

    # Bounding box of the ellipse, in blocks with a pixel centre that it can contain.
    root = sqrt(inside) * (one / ROOT)
    root_xx, root_yy = sqrt(xx), sqrt(yy)
    radius_x, radius_y = root * root_xx + SLACK, root * root_yy + SLACK
    far = spread(F(1e6))
    quarter = F(0.25)
    box_x0 = larger(ceil((larger(u - radius_x, neg(far)) - F(3.5)) * quarter), spread(F(0.0)))
    box_y0 = larger(ceil((larger(v - radius_y, neg(far)) - F(3.5)) * quarter), spread(F(0.0)))
    box_x1 = smaller(floor((smaller(u + radius_x, far) - F(0.5)) * quarter), spread(F(grid[BLOCKS_X] - 1)))
    box_y1 = smaller(floor((smaller(v + radius_y, far) - F(0.5)) * quarter), spread(F(grid[BLOCKS_Y] - 1)))
    live = live & (box_x0 <= box_x1) & (box_y0 <= box_y1)
    if bits(live) == 0:
        return np.int64(0)

    # One byte per band of four pixel rows: the blocks between the left and right ends of the ellipse in the band.
    skew, half = l01 / l00, one / l00
    turning = xy / root_xx * root  # dy of the rightmost point
    low = int_bits(spread(F(0.0)))
    high = low
    ones = low + np.int32(1)
    for band in range(8):
        if bits(live & (box_y0 + F(band) <= box_y1)) == 0:
            break
        top = fma(box_y0 + F(band), F(4.0), F(0.5)) - v
        from_y, to_y = larger(top, neg(radius_y)), smaller(top + F(3.0), radius_y)
        at = clamped(turning, from_y, to_y)
        step = l11 * at
        right = u - skew * at + half * sqrt(larger(inside - step * step, spread(F(0.0)))) + SLACK
        at = clamped(neg(turning), from_y, to_y)
        step = l11 * at
        left = u - skew * at - half * sqrt(larger(inside - step * step, spread(F(0.0)))) - SLACK
        first = larger(ceil((left - F(3.5)) * quarter), box_x0) - box_x0
        last = smaller(floor((right - F(0.5)) * quarter), box_x1) - box_x0
        some = (from_y <= to_y) & (first <= last) & (box_y0 + F(band) <= box_y1)
        first, last = smaller(first, spread(F(8.0))), clamped(last, spread(F(0.0)), spread(F(7.0)))
        byte = ((ones + ones) << to_int(last)) - (ones << to_int(first))
        byte = sel(some, byte, np.int32(0))
        if band < 4:
            low = low | (byte << np.int32(8 * band))
        else:
            high = high | (byte << np.int32(8 * band - 32))
    box_x = to_int(box_x0) + (to_int(box_x1) << np.int32(16))
    box_y = to_int(box_y0) + (to_int(box_y1) << np.int32(16))
    store_transposed(
        records, RECORD * i,
        (
            u, v, l00, l01, l11, log_opacity,
            colors[0], colors[1], colors[2], z,
            slope_t, slope_s, float_bits(low), float_bits(high), float_bits(box_x), float_bits(box_y),
        ),
    )  # fmt: skip
    return bits(live)
