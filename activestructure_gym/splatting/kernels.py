"""Compiled loops of the CPU rasteriser: project, blend front to back, differentiate, step.

Everything is float32 and runs over Gaussians in depth order; each touches only the pixels of its ellipse
alpha >= 1/255, row by row.
"""

from __future__ import annotations

import numpy as np
from numba import njit

F = np.float32
NEAR_PLANE = F(0.01)
BLUR_VARIANCE = F(0.3)
MIN_TRANSMITTANCE = F(1e-4)
LOG2_E = F(1.4426950408889634)
LOG2_255 = F(7.994353436858858)
# Columns of a record.
U, V, XX, XY, YY, LOG2_OPACITY, DEPTH, OPACITY, RADIUS_Y = range(9)


@njit(cache=True, nogil=True)
def _exp2(power):
    """2 ** power for -126 < power < 127: nearest integer by exponent bits, the rest by a degree 5 minimax."""
    whole = np.floor(power + F(0.5))
    f = power - whole
    value = F(1.3276472e-3)
    value = value * f + F(9.6755413e-3)
    value = value * f + F(5.5507133e-2)
    value = value * f + F(0.24022120)
    value = value * f + F(0.69314697)
    value = value * f + F(1.00000007)
    return value * np.int32((np.int32(whole) + np.int32(127)) << np.int32(23)).view(np.float32)


@njit(cache=True, nogil=True)
def _rotation(w, x, y, z):
    two, one = F(2.0), F(1.0)
    return (
        one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y),
        two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x),
        two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def project(parameters, count, pose, lens, width, height, records):
    """Fill ``records [count, 9]``; RADIUS_Y = -1 marks what cannot be seen."""
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    margin_x, margin_y = F(0.15) * F(width) / fx, F(0.15) * F(height) / fy
    for i in range(count):
        records[i, RADIUS_Y] = F(-1.0)
        mx, my, mz = parameters[0, i], parameters[1, i], parameters[2, i]
        x = pose[0, 0] * mx + pose[0, 1] * my + pose[0, 2] * mz + pose[0, 3]
        y = pose[1, 0] * mx + pose[1, 1] * my + pose[1, 2] * mz + pose[1, 3]
        z = pose[2, 0] * mx + pose[2, 1] * my + pose[2, 2] * mz + pose[2, 3]
        if not z >= NEAR_PLANE:
            continue
        opacity = F(1.0) / (F(1.0) + np.exp(-parameters[10, i]))
        log2_opacity = np.log2(opacity)
        if not log2_opacity >= -LOG2_255:
            continue
        kx = min(max(x / z, -cx / fx - margin_x), (F(width) - cx) / fx + margin_x)
        ky = min(max(y / z, -cy / fy - margin_y), (F(height) - cy) / fy + margin_y)
        q0, q1, q2, q3 = parameters[3, i], parameters[4, i], parameters[5, i], parameters[6, i]
        norm = F(1.0) / np.sqrt(q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
        r00, r01, r02, r10, r11, r12, r20, r21, r22 = _rotation(q0 * norm, q1 * norm, q2 * norm, q3 * norm)
        j00, j02, j11, j12 = fx / z, -fx * kx / z, fy / z, -fy * ky / z
        xx, xy, yy, cross = BLUR_VARIANCE, F(0.0), BLUR_VARIANCE, F(0.0)
        # Rows of J R (2x3), then times each column of Rq diag(s).
        a0 = j00 * pose[0, 0] + j02 * pose[2, 0]
        a1 = j00 * pose[0, 1] + j02 * pose[2, 1]
        a2 = j00 * pose[0, 2] + j02 * pose[2, 2]
        b0 = j11 * pose[1, 0] + j12 * pose[2, 0]
        b1 = j11 * pose[1, 1] + j12 * pose[2, 1]
        b2 = j11 * pose[1, 2] + j12 * pose[2, 2]
        s0, s1, s2 = np.exp(parameters[7, i]), np.exp(parameters[8, i]), np.exp(parameters[9, i])
        p0, p1, p2 = (a0 * r00 + a1 * r10 + a2 * r20) * s0, (a0 * r01 + a1 * r11 + a2 * r21) * s1, (
            a0 * r02 + a1 * r12 + a2 * r22
        ) * s2
        n0, n1, n2 = (b0 * r00 + b1 * r10 + b2 * r20) * s0, (b0 * r01 + b1 * r11 + b2 * r21) * s1, (
            b0 * r02 + b1 * r12 + b2 * r22
        ) * s2
        xx = p0 * p0 + p1 * p1 + p2 * p2
        yy = n0 * n0 + n1 * n1 + n2 * n2
        xy = p0 * n0 + p1 * n1 + p2 * n2
        # |p x n|^2 instead of xx yy - xy^2: no cancellation for needles.
        c0, c1, c2 = p1 * n2 - p2 * n1, p2 * n0 - p0 * n2, p0 * n1 - p1 * n0
        cross = c0 * c0 + c1 * c1 + c2 * c2
        determinant = cross + BLUR_VARIANCE * (xx + yy) + BLUR_VARIANCE * BLUR_VARIANCE
        xx += BLUR_VARIANCE
        yy += BLUR_VARIANCE
        extent = F(2.0) * (log2_opacity + LOG2_255) / LOG2_E  # 2 ln(255 o)
        radius_x, radius_y = np.sqrt(extent * xx), np.sqrt(extent * yy)
        u, v = fx * x / z + cx, fy * y / z + cy
        if not (u + radius_x > 0 and u - radius_x < width and v + radius_y > 0 and v - radius_y < height):
            continue
        inverse = F(1.0) / determinant
        records[i, U], records[i, V], records[i, DEPTH] = u, v, z
        records[i, XX], records[i, XY], records[i, YY] = yy * inverse, -xy * inverse, xx * inverse
        records[i, LOG2_OPACITY], records[i, OPACITY] = log2_opacity, opacity
        records[i, RADIUS_Y] = radius_y + F(1e-3)


@njit(cache=True, nogil=True)
def _row_range(record, row, width):
    """First and last + 1 column of the row that the ellipse can reach."""
    dy = F(row) + F(0.5) - record[V]
    xx, xy, yy = record[XX], record[XY], record[YY]
    extent = F(2.0) * (record[LOG2_OPACITY] + LOG2_255) / LOG2_E
    skew = xy / xx
    room = (extent - (yy - xy * skew) * dy * dy) / xx
    if not room > 0:
        if not room > F(-0.01) / xx:
            return 0, 0
        room = F(0.0)
    half = np.sqrt(room) + F(0.01)
    centre = record[U] - skew * dy
    left, right = max(centre - half, F(0.0)), min(centre + half, F(width))
    if right <= left:
        return 0, 0
    return np.int64(left), min(np.int64(right) + 1, width)


@njit(cache=True, nogil=True)
def blend(records, order, colors, log2_max_alpha, image, depth, transmittance):
    """Front to back. ``transmittance`` ends negative where the pixel stopped early."""
    height, width = depth.shape
    for i in order:
        record = records[i]
        z, r, g, b = record[DEPTH], colors[0, i], colors[1, i], colors[2, i]
        scale = F(-0.5) * LOG2_E
        xx, xy, yy = scale * record[XX], F(2.0) * scale * record[XY], scale * record[YY]
        first = max(np.int64(record[V] - record[RADIUS_Y]), 0)
        last = min(np.int64(max(record[V] + record[RADIUS_Y], F(0.0))) + 1, height)
        for row in range(first, last):
            start, stop = _row_range(record, row, width)
            dy = F(row) + F(0.5) - record[V]
            for column in range(start, stop):
                before = transmittance[row, column]
                dx = F(column) + F(0.5) - record[U]
                power = record[LOG2_OPACITY] + (xx * dx + xy * dy) * dx + yy * dy * dy
                if before < 0 or power < -LOG2_255:
                    continue
                weight = _exp2(min(power, log2_max_alpha)) * before
                after = before - weight
                if after <= MIN_TRANSMITTANCE:
                    transmittance[row, column] = -before
                    continue
                transmittance[row, column] = after
                image[row, column, 0] += weight * r
                image[row, column, 1] += weight * g
                image[row, column, 2] += weight * b
                depth[row, column] += weight * z


@njit(cache=True, nogil=True)
def blend_backward(records, order, colors, log2_max_alpha, by_image, by_depth, by_alpha, rest, transmittance, moments):
    """Front to back again; ``rest`` starts as C.gC + D gD + A gA and loses each term as it passes.

    ``moments [count, 11]``: sums of v = alpha dL/dalpha times (1, dx, dy, dx^2, dx dy, dy^2), of the weight times the
    gradients of (r, g, b, depth), and of the weight.
    """
    height, width = by_depth.shape
    for i in order:
        record = records[i]
        z, r, g, b = record[DEPTH], colors[0, i], colors[1, i], colors[2, i]
        scale = F(-0.5) * LOG2_E
        xx, xy, yy = scale * record[XX], F(2.0) * scale * record[XY], scale * record[YY]
        first = max(np.int64(record[V] - record[RADIUS_Y]), 0)
        last = min(np.int64(max(record[V] + record[RADIUS_Y], F(0.0))) + 1, height)
        m = moments[i]
        for row in range(first, last):
            start, stop = _row_range(record, row, width)
            dy = F(row) + F(0.5) - record[V]
            for column in range(start, stop):
                before = transmittance[row, column]
                dx = F(column) + F(0.5) - record[U]
                power = record[LOG2_OPACITY] + (xx * dx + xy * dy) * dx + yy * dy * dy
                if before < 0 or power < -LOG2_255:
                    continue
                alpha = _exp2(min(power, log2_max_alpha))
                weight = alpha * before
                after = before - weight
                if after <= MIN_TRANSMITTANCE:
                    transmittance[row, column] = -before
                    continue
                transmittance[row, column] = after
                g0, g1, g2 = by_image[row, column, 0], by_image[row, column, 1], by_image[row, column, 2]
                gd = by_depth[row, column]
                term = weight * (r * g0 + g * g1 + b * g2 + z * gd + by_alpha[row, column])
                rest[row, column] -= term
                m[6] += weight * g0
                m[7] += weight * g1
                m[8] += weight * g2
                m[9] += weight * gd
                m[10] += weight
                if power <= log2_max_alpha:
                    v = term - alpha / (F(1.0) - alpha) * rest[row, column]
                    m[0] += v
                    m[1] += v * dx
                    m[2] += v * dy
                    m[3] += v * dx * dx
                    m[4] += v * dx * dy
                    m[5] += v * dy * dy


@njit(cache=True, nogil=True)
def project_backward(parameters, order, records, moments, pose, lens, width, height, gradient, by_pose):
    """From the moments of each Gaussian to ``gradient [14, count]`` and ``by_pose [3, 4]``."""
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    low_x, high_x = -cx / fx - F(0.15) * F(width) / fx, (F(width) - cx) / fx + F(0.15) * F(width) / fx
    low_y, high_y = -cy / fy - F(0.15) * F(height) / fy, (F(height) - cy) / fy + F(0.15) * F(height) / fy
    half, two = F(0.5), F(2.0)
    rotation, scaled = np.empty((3, 3), np.float32), np.empty((3, 3), np.float32)
    turned, by_turned = np.empty((3, 3), np.float32), np.empty((3, 3), np.float32)
    by_scaled, by_point = np.empty((3, 3), np.float32), np.empty(3, np.float32)
    for i in order:
        m = moments[i]
        if not m[10] > 0:
            continue
        p00, p01, p11 = records[i, XX], records[i, XY], records[i, YY]
        # dL/d mean2d = P S1, dL/d covariance = 1/2 P S2 P (dx is pixel minus mean).
        by_u, by_v = p00 * m[1] + p01 * m[2], p01 * m[1] + p11 * m[2]
        t00, t01 = p00 * m[3] + p01 * m[4], p00 * m[4] + p01 * m[5]
        t10, t11 = p01 * m[3] + p11 * m[4], p01 * m[4] + p11 * m[5]
        s00, s01, s11 = half * (t00 * p00 + t01 * p01), half * (t00 * p01 + t01 * p11), half * (t10 * p01 + t11 * p11)
        gradient[10, i] = (F(1.0) - records[i, OPACITY]) * m[0]
        gradient[11, i], gradient[12, i], gradient[13, i] = m[6], m[7], m[8]

        x = pose[0, 0] * parameters[0, i] + pose[0, 1] * parameters[1, i] + pose[0, 2] * parameters[2, i] + pose[0, 3]
        y = pose[1, 0] * parameters[0, i] + pose[1, 1] * parameters[1, i] + pose[1, 2] * parameters[2, i] + pose[1, 3]
        z = records[i, DEPTH]
        q0, q1, q2, q3 = parameters[3, i], parameters[4, i], parameters[5, i], parameters[6, i]
        norm = F(1.0) / np.sqrt(q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
        q0, q1, q2, q3 = q0 * norm, q1 * norm, q2 * norm, q3 * norm
        (
            rotation[0, 0], rotation[0, 1], rotation[0, 2],
            rotation[1, 0], rotation[1, 1], rotation[1, 2],
            rotation[2, 0], rotation[2, 1], rotation[2, 2],
        ) = _rotation(q0, q1, q2, q3)  # fmt: skip
        for k in range(3):
            scale = np.exp(parameters[7 + k, i])
            for j in range(3):
                scaled[j, k] = rotation[j, k] * scale
        for j in range(3):
            for k in range(3):
                turned[j, k] = pose[j, 0] * scaled[0, k] + pose[j, 1] * scaled[1, k] + pose[j, 2] * scaled[2, k]
        inside_x, inside_y = low_x <= x / z <= high_x, low_y <= y / z <= high_y
        tx, ty = min(max(x / z, low_x), high_x), min(max(y / z, low_y), high_y)
        j00, j02, j11, j12 = fx / z, -fx * tx / z, fy / z, -fy * ty / z
        by_j00, by_j02, by_j11, by_j12 = F(0.0), F(0.0), F(0.0), F(0.0)
        for k in range(3):
            b0 = j00 * turned[0, k] + j02 * turned[2, k]
            b1 = j11 * turned[1, k] + j12 * turned[2, k]
            by_b0, by_b1 = two * (s00 * b0 + s01 * b1), two * (s01 * b0 + s11 * b1)
            by_turned[0, k], by_turned[1, k], by_turned[2, k] = j00 * by_b0, j11 * by_b1, j02 * by_b0 + j12 * by_b1
            by_j00 += by_b0 * turned[0, k]
            by_j02 += by_b0 * turned[2, k]
            by_j11 += by_b1 * turned[1, k]
            by_j12 += by_b1 * turned[2, k]
        by_point[0], by_point[1] = fx / z * by_u, fy / z * by_v
        by_point[2] = m[9] - (fx * x * by_u + fy * y * by_v + fx * by_j00 + fy * by_j11) / (z * z)
        # j02 = -fx clamp(x/z) / z: inside both factors move, outside only the last.
        by_point[2] += (fx * tx * by_j02 + fy * ty * by_j12) / (z * z)
        if inside_x:
            by_point[0] -= fx / (z * z) * by_j02
            by_point[2] += fx * tx / (z * z) * by_j02
        if inside_y:
            by_point[1] -= fy / (z * z) * by_j12
            by_point[2] += fy * ty / (z * z) * by_j12
        for j in range(3):
            by_pose[j, 3] += by_point[j]
            gradient[j, i] = pose[0, j] * by_point[0] + pose[1, j] * by_point[1] + pose[2, j] * by_point[2]
            for k in range(3):
                by_pose[j, k] += by_point[j] * parameters[k, i]
                for n in range(3):
                    by_pose[j, k] += by_turned[j, n] * scaled[k, n]
                by_scaled[j, k] = (
                    pose[0, j] * by_turned[0, k] + pose[1, j] * by_turned[1, k] + pose[2, j] * by_turned[2, k]
                )
        for k in range(3):
            gradient[7 + k, i] = (
                scaled[0, k] * by_scaled[0, k] + scaled[1, k] * by_scaled[1, k] + scaled[2, k] * by_scaled[2, k]
            )
            scale = np.exp(parameters[7 + k, i])
            for j in range(3):
                by_scaled[j, k] *= scale  # now the derivative by the rotation
        h = by_scaled
        gw = two * (q1 * (h[2, 1] - h[1, 2]) + q2 * (h[0, 2] - h[2, 0]) + q3 * (h[1, 0] - h[0, 1]))
        gx = two * (
            -two * q1 * (h[1, 1] + h[2, 2]) + q2 * (h[1, 0] + h[0, 1]) + q3 * (h[2, 0] + h[0, 2])
            + q0 * (h[2, 1] - h[1, 2])
        )
        gy = two * (
            q1 * (h[1, 0] + h[0, 1]) - two * q2 * (h[0, 0] + h[2, 2]) + q3 * (h[2, 1] + h[1, 2])
            + q0 * (h[0, 2] - h[2, 0])
        )
        gz = two * (
            q1 * (h[2, 0] + h[0, 2]) + q2 * (h[2, 1] + h[1, 2]) - two * q3 * (h[0, 0] + h[1, 1])
            + q0 * (h[1, 0] - h[0, 1])
        )
        along = q0 * gw + q1 * gx + q2 * gy + q3 * gz
        gradient[3, i], gradient[4, i] = (gw - q0 * along) * norm, (gx - q1 * along) * norm
        gradient[5, i], gradient[6, i] = (gy - q2 * along) * norm, (gz - q3 * along) * norm


@njit(cache=True, nogil=True)
def adam(parameters, first, second, order, moments, gradient, rates, beta1, beta2, epsilon):
    """Visible-only Adam without bias correction: Gaussians with a weight in some pixel move, the rest stand still."""
    one = F(1.0)
    for i in order:
        if not moments[i, 10] > 0:
            continue
        for row in range(14):
            g = gradient[row, i]
            m = beta1 * first[row, i] + (one - beta1) * g
            s = beta2 * second[row, i] + (one - beta2) * g * g
            first[row, i], second[row, i] = m, s
            parameters[row, i] -= rates[row] * m / (np.sqrt(s) + epsilon)
