"""Compute the gradients of the parameters from the sums of every entry, and write them or take an Adam step.

An entry is a pair of tile and Gaussian; its slot holds sums over the pixels (`blending.blend_backward`). A value of 16
Gaussians is one vector.
"""

# mypy: ignore-errors
# (the arguments of kernels have numba's types, and intrinsics are called without their typing context)

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from activestructure_gym.splatting.counters import STEPPED, TILES_DONE, all_done, take_ticket
from activestructure_gym.splatting.elementary import dot3, larger
from activestructure_gym.splatting.layout import (
    BETA1,
    BETA2,
    CAPACITY,
    CHUNK,
    COUNT,
    EPSILON,
    FX,
    FY,
    HIGH_X,
    HIGH_Y,
    ISOTROPIC,
    L00,
    L01,
    L11,
    LN_4,
    LOW_X,
    LOW_Y,
    MODE,
    NEAR_PLANE,
    RECORD,
    ROWS,
    SLANT,
    SLANT_VARIANCE,
    SLOT,
    SLOTS,
    TILES_X,
    TILES_Y,
    V_,
    VS,
    VSS,
    VT,
    VTS,
    VTT,
    W_ALL,
    W_BLUE,
    W_DEPTH,
    W_DEPTH_S,
    W_DEPTH_T,
    W_GREEN,
    W_RED,
)
from activestructure_gym.splatting.memory import (
    SUM_LANES,
    load,
    load_sums,
    load_transposed,
    peek,
    peek_bits,
    poke,
    prefetch,
    store,
    sums,
)
from activestructure_gym.splatting.projection import (
    camera_point,
    depth_slopes,
    jacobian_of,
    opacity_of,
    rotation_of,
    scale_of,
)
from activestructure_gym.splatting.simd import LANES, F, bits, fma, inline, inner, neg, sel, spread, sqrt
from activestructure_gym.splatting.tile_losses import TILE_TERMS


@inline
def _add_outer(pose, seen, a0, a1, a2, b0, b1, b2):
    """Add a_j b_k to pose[3 j + k], in the lanes of the mask ``seen``."""
    a0, a1, a2 = sel(seen, a0, F(0.0)), sel(seen, a1, F(0.0)), sel(seen, a2, F(0.0))
    b0, b1, b2 = sel(seen, b0, F(0.0)), sel(seen, b1, F(0.0)), sel(seen, b2, F(0.0))
    store(pose, 0, fma(a0, b0, load(pose, 0)))
    store(pose, LANES, fma(a0, b1, load(pose, LANES)))
    store(pose, LANES * 2, fma(a0, b2, load(pose, LANES * 2)))
    store(pose, LANES * 3, fma(a1, b0, load(pose, LANES * 3)))
    store(pose, LANES * 4, fma(a1, b1, load(pose, LANES * 4)))
    store(pose, LANES * 5, fma(a1, b2, load(pose, LANES * 5)))
    store(pose, LANES * 6, fma(a2, b0, load(pose, LANES * 6)))
    store(pose, LANES * 7, fma(a2, b1, load(pose, LANES * 7)))
    store(pose, LANES * 8, fma(a2, b2, load(pose, LANES * 8)))


class _Shared(NamedTuple):
    """Hold data common to the three axes of 16 Gaussians, as vectors."""

    covariance: Any  # (s00, s01, s11): derivatives by the projected covariance, the first and last halved
    leaning: Any  # (a0, a1): derivatives by the covariance of projection and depth
    lens: Any  # (j00, j02, j11, j12): Jacobian of the projection
    seen: Any  # mask of the Gaussians with a weight in the image


@inline
def _turned_axis(axis, scale, lens, view):
    """Return one axis of 16 Gaussians in the world (3 components), in the camera frame (3) and in the image (2).

    ``axis`` is the unit axis in the world, and ``scale`` its length in metres.
    """
    j00, j02, j11, j12 = lens
    k0, k1, k2 = axis[0] * scale, axis[1] * scale, axis[2] * scale
    t0 = dot3(k0, k1, k2, spread(view[0]), spread(view[1]), spread(view[2]))
    t1 = dot3(k0, k1, k2, spread(view[4]), spread(view[5]), spread(view[6]))
    t2 = dot3(k0, k1, k2, spread(view[8]), spread(view[9]), spread(view[10]))
    return k0, k1, k2, t0, t1, t2, fma(j02, t2, j00 * t0), fma(j12, t2, j11 * t1)


@inline
def _axis_gradient(turned, scale, row, shared, view, gradient, pose):
    """Compute the gradient through one axis: write the one by its log-scale, and add the one by the pose.

    ``turned`` is the axis from `_turned_axis`, ``row`` its row in ``gradient``, and ``shared`` a `_Shared`. Returns the
    derivatives by the axis direction (3) and by J00, J02, J11, J12.
    """
    s00, s01, s11 = shared.covariance
    a0, a1 = shared.leaning
    j00, j02, j11, j12 = shared.lens
    k0, k1, k2, t0, t1, t2, b0, b1 = turned
    by_b0 = fma(a0, t2, fma(s01, b1, s00 * b0) * F(2.0))
    by_b1 = fma(a1, t2, fma(s11, b1, s01 * b0) * F(2.0))
    by_t0, by_t1 = j00 * by_b0, j11 * by_b1
    by_t2 = fma(a1, b1, fma(a0, b0, fma(j12, by_b1, j02 * by_b0)))
    _add_outer(pose, shared.seen, by_t0, by_t1, by_t2, k0, k1, k2)
    d0 = fma(by_t2, view[8], fma(by_t1, view[4], by_t0 * view[0]))
    d1 = fma(by_t2, view[9], fma(by_t1, view[5], by_t0 * view[1]))
    d2 = fma(by_t2, view[10], fma(by_t1, view[6], by_t0 * view[2]))
    store(gradient, LANES * row, dot3(k0, k1, k2, d0, d1, d2))
    return d0 * scale, d1 * scale, d2 * scale, by_b0 * t0, by_b0 * t2, by_b1 * t1, by_b1 * t2


@inline
def _splat_gradient(parameters, i, view, grid, records, sums_of, gradient, pose):
    """Compute the gradients of Gaussians i to i + 15; return the bits of Gaussians with a weight in the image.

    The gradients are written to ``gradient [14 * 16]``, and the gradient of the pose is added to ``pose [12 * 16]``.
    ``sums_of [16 * 16]`` holds the sums of every Gaussian, zero for Gaussians without entries.
    """
    capacity = grid[CAPACITY]
    m = load_sums(sums_of, 0)
    seen = m[W_ALL] > F(0.0)
    if bits(seen) == 0:
        return np.int64(0)
    record = load_transposed(records, RECORD * i)
    l00, l01, l11 = sel(seen, record[L00], F(0.0)), sel(seen, record[L01], F(0.0)), sel(seen, record[L11], F(0.0))
    by_u, by_v = l00 * m[VT] * LN_4, fma(l01, m[VT], l11 * m[VS]) * LN_4
    half = F(0.5) * LN_4 * LN_4
    first, second = fma(l01, m[VTT], l11 * m[VTS]), fma(l01, m[VTS], l11 * m[VSS])
    s00, s01, s11 = l00 * l00 * m[VTT] * half, l00 * first * half, fma(l01, first, l11 * second) * half

    x, y, z = camera_point(parameters, capacity, i, view)
    z = larger(z, spread(NEAR_PLANE))
    inverse_z = spread(F(1.0)) / z
    j00, j02, j11, j12, slope_x, slope_y = jacobian_of(x, y, inverse_z, view)
    (q0, q1, q2, q3), inverse_length, r = rotation_of(parameters, capacity, i)
    s0 = scale_of(parameters, capacity, i, np.int64(0))
    s1 = scale_of(parameters, capacity, i, np.int64(1))
    s2 = scale_of(parameters, capacity, i, np.int64(2))
    lens = (j00, j02, j11, j12)
    first = _turned_axis((r[0], r[3], r[6]), s0, lens, view)
    second = _turned_axis((r[1], r[4], r[7]), s1, lens, view)
    third = _turned_axis((r[2], r[5], r[8]), s2, lens, view)
    # The depth at pixel offset d from the mean is z + e.d. a is A^-1 times the gradient by e.
    p, n, along = (first[6], second[6], third[6]), (first[7], second[7], third[7]), (first[5], second[5], third[5])
    e0, e1, flat = depth_slopes(p, n, along, view)
    by_u, by_v = by_u - e0 * m[W_DEPTH], by_v - e1 * m[W_DEPTH]
    d1 = m[W_DEPTH_S] / sel(seen, l11, F(1.0)) * view[SLANT]
    d0 = (m[W_DEPTH_T] * view[SLANT] - l01 * d1) / sel(seen, l00, F(1.0))
    xy = dot3(*p, *n)
    a0 = fma(dot3(*n, *n) + SLANT_VARIANCE, d0, neg(xy * d1)) / flat
    a1 = fma(dot3(*p, *p) + SLANT_VARIANCE, d1, neg(xy * d0)) / flat
    s00, s01, s11 = s00 - a0 * e0, s01 - fma(a0, e1, a1 * e0) * F(0.5), s11 - a1 * e1
    shared = _Shared((s00, s01, s11), (a0, a1), lens, seen)
    h0, h3, h6, x00, x02, x11, x12 = _axis_gradient(first, s0, np.int64(7), shared, view, gradient, pose)
    h1, h4, h7, y00, y02, y11, y12 = _axis_gradient(second, s1, np.int64(8), shared, view, gradient, pose)
    h2, h5, h8, z00, z02, z11, z12 = _axis_gradient(third, s2, np.int64(9), shared, view, gradient, pose)
    by_j00, by_j02, by_j11, by_j12 = x00 + y00 + z00, x02 + y02 + z02, x11 + y11 + z11, x12 + y12 + z12
    h = (h0, h1, h2, h3, h4, h5, h6, h7, h8)
    g0 = fma(q1, h[7] - h[5], fma(q2, h[2] - h[6], q3 * (h[3] - h[1])))
    g1 = fma(q2, h[3] + h[1], fma(q3, h[6] + h[2], fma(q0, h[7] - h[5], q1 * (h[4] + h[8]) * F(-2.0))))
    g2 = fma(q1, h[3] + h[1], fma(q3, h[7] + h[5], fma(q0, h[2] - h[6], q2 * (h[0] + h[8]) * F(-2.0))))
    g3 = fma(q1, h[6] + h[2], fma(q2, h[7] + h[5], fma(q0, h[3] - h[1], q3 * (h[0] + h[4]) * F(-2.0))))
    along = fma(q0, g0, fma(q1, g1, fma(q2, g2, q3 * g3)))
    twice = inverse_length + inverse_length
    store(gradient, LANES * 3, (g0 - q0 * along) * twice)
    store(gradient, LANES * 4, (g1 - q1 * along) * twice)
    store(gradient, LANES * 5, (g2 - q2 * along) * twice)
    store(gradient, LANES * 6, (g3 - q3 * along) * twice)

    # Gradient by the mean in the camera frame: through its pixel, the depth and the Jacobian.
    square = inverse_z * inverse_z
    f_x, f_y = square * view[FX], square * view[FY]
    inside_x = (x * inverse_z >= view[LOW_X]) & (x * inverse_z <= view[HIGH_X])
    inside_y = (y * inverse_z >= view[LOW_Y]) & (y * inverse_z <= view[HIGH_Y])
    moved_x, moved_y = sel(inside_x, f_x * by_j02, F(0.0)), sel(inside_y, f_y * by_j12, F(0.0))
    by_x, by_y = j00 * by_u - moved_x, j11 * by_v - moved_y
    by_z = m[W_DEPTH] - fma(f_x, fma(x, by_u, by_j00), f_y * fma(y, by_v, by_j11))
    # J02 = -fx clamp(x / z) / z. Outside the clamping limits only its last factor varies.
    by_z = by_z + fma(slope_x, fma(f_x, by_j02, moved_x), slope_y * fma(f_y, by_j12, moved_y))
    mx, my, mz = load(parameters, i), load(parameters, capacity + i), load(parameters, 2 * capacity + i)
    _add_outer(pose, seen, by_x, by_y, by_z, mx, my, mz)
    store(pose, LANES * 9, load(pose, LANES * 9) + sel(seen, by_x, F(0.0)))
    store(pose, LANES * 10, load(pose, LANES * 10) + sel(seen, by_y, F(0.0)))
    store(pose, LANES * 11, load(pose, LANES * 11) + sel(seen, by_z, F(0.0)))
    store(gradient, 0, fma(by_z, view[8], fma(by_y, view[4], by_x * view[0])))
    store(gradient, LANES, fma(by_z, view[9], fma(by_y, view[5], by_x * view[1])))
    store(gradient, LANES * 2, fma(by_z, view[10], fma(by_y, view[6], by_x * view[2])))
    _, complement, _ = opacity_of(parameters, capacity, i)
    store(gradient, LANES * 10, complement * m[V_])
    store(gradient, LANES * 11, m[W_RED])
    store(gradient, LANES * 12, m[W_GREEN])
    store(gradient, LANES * 13, m[W_BLUE])
    return bits(seen)


@inner
def _step_chunk(number, lists, step, scratch):
    """Sum the slots of the 1024 Gaussians of chunk ``lists.taken[number]``; then take a step or write gradients.

    ``rates[MODE]`` selects an Adam step, gradients of all parameters, or the gradient of the pose only. ``scratch [42 *
    16]`` is workspace: summed slots, gradient, pose.
    """
    view, grid, records, visible = lists.camera, lists.grid, lists.records, lists.visible
    parameters, first_moment, second_moment = step.parameters, step.first_moment, step.second_moment
    rates, slots, gradient, pose_parts = step.rates, step.slots, step.gradient, step.pose_parts
    capacity, zero = grid[CAPACITY], spread(F(0.0))
    sums_of, own, pose = scratch[: 16 * LANES], scratch[16 * LANES : 30 * LANES], scratch[30 * LANES :]
    for k in range(12):
        store(pose, LANES * k, zero)
    beta1, beta2, epsilon, stepping = rates[BETA1], rates[BETA2], rates[EPSILON], rates[MODE] > F(0.0)
    chunk = lists.taken[number]
    end = min((chunk + 1) * CHUNK, grid[COUNT])
    for i in range(chunk * CHUNK, end, LANES):
        seen = np.int64(peek(visible, i // LANES))
        if seen == 0:
            continue
        later = min(i + LANES, end - 1)
        if peek(visible, later // LANES) != 0:
            for row in range(ROWS):  # too many streams for the hardware's prefetcher
                prefetch(parameters, row * capacity + later)
                if stepping:
                    prefetch(first_moment, row * capacity + later)
                    prefetch(second_moment, row * capacity + later)
        for lane in range(LANES):
            total = zero
            if (seen >> lane) & 1:
                base = RECORD * (i + lane)
                slot = peek_bits(records, base + SLOT)
                for at in range(slot, slot + peek_bits(records, base + SLOTS)):
                    total = total + load(slots, LANES * at)
            store(sums_of, LANES * lane, total)
        seen = _splat_gradient(parameters, i, view, grid, records, sums_of, own, pose)
        if seen == 0 or rates[MODE] < F(0.0):
            continue
        if rates[ISOTROPIC] > F(0.0):
            together = load(own, LANES * 7) + load(own, LANES * 8) + load(own, LANES * 9)
            store(own, LANES * 7, together)
            store(own, LANES * 8, together)
            store(own, LANES * 9, together)
        mask = load_sums(sums_of, 0)[W_ALL] > F(0.0)
        for row in range(ROWS):
            g = sel(mask, load(own, LANES * row), F(0.0))
            at = row * capacity + i
            if not stepping:
                store(gradient, at, g)
                continue
            # Differences are masked, and not results: a selection before a store becomes a slow masked store.
            m, s = load(first_moment, at), load(second_moment, at)
            m = m + sel(mask, (g - m) * (F(1.0) - beta1), F(0.0))
            s = s + sel(mask, (g * g - s) * (F(1.0) - beta2), F(0.0))
            store(first_moment, at, m)
            store(second_moment, at, s)
            move = m / (sqrt(s) + epsilon) * rates[row]
            store(parameters, at, load(parameters, at) - sel(mask, move, F(0.0)))
    store(
        pose_parts, LANES * number,
        sums((
            load(pose, 0), load(pose, 16), load(pose, 32), load(pose, 48), load(pose, 64), load(pose, 80),
            load(pose, 96), load(pose, 112), load(pose, 128), load(pose, 144), load(pose, 160), load(pose, 176),
        )),
    )  # fmt: skip


# Offsets in the results: gradient by camera_from_world [3, 4], then the sums of the losses' terms over all tiles.
OF_POSE, RESULTS = 12, 14
_POSE_LANES = np.array([[SUM_LANES.index(x) for x in (3 * j, 3 * j + 1, 3 * j + 2, 9 + j)] for j in range(3)]).ravel()


@inner
def _sum_up(chunks, grid, pose_parts, terms, results):
    """Sum pose gradients over chunks and loss terms over tiles into ``results [14]``, in float64, in a fixed order."""
    for number in range(OF_POSE):
        total = 0.0
        for chunk in range(chunks):
            total += peek(pose_parts, LANES * chunk + peek(_POSE_LANES, number))
        poke(results, number, total)
    if len(terms) == 0:
        return
    for number in range(2):
        total = 0.0
        for tile in range(grid[TILES_X] * grid[TILES_Y]):
            for lane in range(LANES):
                total += peek(terms, TILE_TERMS * tile + LANES * number + lane)
        poke(results, OF_POSE + number, total)


@inner
def step_parameters(tickets, lists, step, terms, scratch):
    """Take the optimiser's step in every chunk of Gaussians in the image, once all tiles have written their gradients.

    The last thread to finish a chunk sums the pose gradients and the loss terms (`_sum_up`).
    """
    grid, chunks = lists.grid, len(lists.taken)
    if not all_done(tickets, TILES_DONE, grid[TILES_X] * grid[TILES_Y]):
        return
    while True:
        number = take_ticket(tickets, 6)
        if number >= chunks:
            return
        _step_chunk(number, lists, step, scratch)
        if take_ticket(tickets, STEPPED) == chunks - 1:
            _sum_up(chunks, grid, step.pose_parts, terms, step.results)
