"""Compute the compiled loops of plane detection over blocks and pixels.

The moments of a set of points are ten sums in the order ``[1, x, y, z, xx, xy, xz, yy, yz, zz]``. Moments of two sets
can be added, so blocks, regions and merged planes are fitted in the same way. All points are in the camera frame.
``lens`` [4] is fx, fy, cx, cy in pixels. A plane [5] is the unit normal, d and the rms distance of its points, with
normal . x + d = 0. The largest distance allowed for noise is ``sigmas * noise(z, scale) + base`` metres.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry.depth_noise import axial_sigma

MOMENTS = 10  # number of moments of a set of points
# Largest angle between two blocks with any noise: beyond it there is a room edge between them.
MAX_LINK_ANGLE = np.radians(40.0)


class Blocks(NamedTuple):
    """Hold the blocks of an image and their planes."""

    moments: np.ndarray  # [By, Bx, 10] moments of the pixels
    planes: np.ndarray  # [By, Bx, 5] normal, d, rms
    accepted: np.ndarray  # [By, Bx] bool: planar blocks
    tilt: np.ndarray  # [By, Bx] radians: largest deviation of the normal due to noise


class Choice(NamedTuple):
    """Hold the planes to which a pixel can be assigned: the planes of its own and the surrounding blocks."""

    size: int  # side of a block, pixels
    labels: np.ndarray  # [By, Bx] int32 plane of each block, -1 = none
    planes: np.ndarray  # [S, 5] normal, d, rms


@kernel
def add_point(moments, x, y, z):
    """Add the point (x, y, z) to ``moments`` [10]."""
    moments[0] += 1.0
    moments[1] += x
    moments[2] += y
    moments[3] += z
    moments[4] += x * x
    moments[5] += x * y
    moments[6] += x * z
    moments[7] += y * y
    moments[8] += y * z
    moments[9] += z * z


@kernel
def refit(moments, plane):
    """Change ``plane = [nx, ny, nz, d, ...]`` to the least-squares plane of ``moments`` [10], in place.

    The iteration starts from the current value.

    The normal is the direction of least variance, found by inverse iteration with the adjugate matrix, which is defined
    for exactly flat points too. Two iterations suffice, because the old normal is close and the variance across the
    plane is much smaller than along it. LAPACK calls would take seconds to compile.
    """
    count = moments[0]
    mx, my, mz = moments[1] / count, moments[2] / count, moments[3] / count
    xx = moments[4] / count - mx * mx
    xy = moments[5] / count - mx * my
    xz = moments[6] / count - mx * mz
    yy = moments[7] / count - my * my
    yz = moments[8] / count - my * mz
    zz = moments[9] / count - mz * mz
    nx, ny, nz = plane[0], plane[1], plane[2]
    for _ in range(2):
        x = (yy * zz - yz * yz) * nx + (xz * yz - xy * zz) * ny + (xy * yz - xz * yy) * nz
        y = (xz * yz - xy * zz) * nx + (xx * zz - xz * xz) * ny + (xy * xz - xx * yz) * nz
        z = (xy * yz - xz * yy) * nx + (xy * xz - xx * yz) * ny + (xx * yy - xy * xy) * nz
        length = np.sqrt(x * x + y * y + z * z)
        if length < 1e-300:
            return
        nx, ny, nz = x / length, y / length, z / length
    plane[0], plane[1], plane[2] = nx, ny, nz
    plane[3] = -(nx * mx + ny * my + nz * mz)


@kernel
def fit_planes(moments):
    """Return least-squares planes [S, 5] (unit normal, d > 0, rms) and centroids [S, 3] of moments [S, 10].

    Normals point towards the camera. Eigenvectors are computed by Jacobi rotations, which take a fiftieth of the time
    of a LAPACK call for 3 x 3 matrices.
    """
    count = len(moments)
    planes, means = np.empty((count, 5)), np.empty((count, 3))
    a, axes = np.empty((3, 3)), np.empty((3, 3))
    for i in range(count):
        m = moments[i]
        n = max(m[0], 1.0)
        mx, my, mz = m[1] / n, m[2] / n, m[3] / n
        means[i, 0], means[i, 1], means[i, 2] = mx, my, mz
        a[0, 0], a[0, 1], a[0, 2] = m[4] / n - mx * mx, m[5] / n - mx * my, m[6] / n - mx * mz
        a[1, 1], a[1, 2], a[2, 2] = m[7] / n - my * my, m[8] / n - my * mz, m[9] / n - mz * mz
        a[1, 0], a[2, 0], a[2, 1] = a[0, 1], a[0, 2], a[1, 2]
        for p in range(3):
            for q in range(3):
                axes[p, q] = 1.0 if p == q else 0.0
        for _ in range(12):
            off = a[0, 1] ** 2 + a[0, 2] ** 2 + a[1, 2] ** 2
            if off <= 1e-32 * (a[0, 0] ** 2 + a[1, 1] ** 2 + a[2, 2] ** 2):
                break
            for k in range(3):
                p, q = (0, 1) if k == 0 else (0, 2) if k == 1 else (1, 2)
                if abs(a[p, q]) < 1e-300:
                    continue
                theta = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
                t = (1.0 if theta >= 0 else -1.0) / (abs(theta) + np.sqrt(theta * theta + 1.0))
                c = 1.0 / np.sqrt(t * t + 1.0)
                s = t * c
                for r in range(3):
                    x, y = a[r, p], a[r, q]
                    a[r, p], a[r, q] = c * x - s * y, s * x + c * y
                for r in range(3):
                    x, y = a[p, r], a[q, r]
                    a[p, r], a[q, r] = c * x - s * y, s * x + c * y
                for r in range(3):
                    x, y = axes[r, p], axes[r, q]
                    axes[r, p], axes[r, q] = c * x - s * y, s * x + c * y
        least = 0
        for k in range(1, 3):
            if a[k, k] < a[least, least]:
                least = k
        nx, ny, nz = axes[0, least], axes[1, least], axes[2, least]
        d = -(nx * mx + ny * my + nz * mz)
        side = -1.0 if d < 0 else 1.0
        planes[i, 0], planes[i, 1], planes[i, 2], planes[i, 3] = side * nx, side * ny, side * nz, side * d
        planes[i, 4] = np.sqrt(max(a[least, least], 0.0))
    return planes, means


@kernel
def block_moments(depth, lens, size, max_depth):
    """Return the moments [By, Bx, 10] of the pixels of every full block of ``size`` x ``size`` pixels.

    Pixels without return or deeper than ``max_depth`` metres are left out.
    """
    fx, fy, cx, cy = lens
    rows, columns = depth.shape[0] // size, depth.shape[1] // size
    moments = np.zeros((rows, columns, MOMENTS))
    for r in range(rows):
        for c in range(columns):
            block = moments[r, c]
            for v in range(r * size, (r + 1) * size):
                y1 = (v + 0.5 - cy) / fy
                for u in range(c * size, (c + 1) * size):
                    z = np.float64(depth[v, u])
                    if 0.0 < z <= max_depth:
                        add_point(block, (u + 0.5 - cx) / fx * z, y1 * z, z)
    return moments


_axial_sigma = kernel(axial_sigma)


@kernel
def noise(z, scale):
    """Return the standard deviation of the depth z in metres: the axial noise of a Kinect times ``scale``."""
    return scale * _axial_sigma(z)


@kernel
def planar_blocks(moments, planes, mean, size, focal, scale, limits):
    """Return which blocks are planar [B], which of these have an uncertain normal [B], and its deviation [B] (radians).

    The deviation is the standard deviation of the fitted normal for uniformly distributed points in a square: sigma *
    sqrt(12) / (side of the block * sqrt(pixels)). It is large for distant blocks of a noisy sensor. ``moments``
    [B, 10], ``planes`` [B, 5] and ``mean`` [B, 3] describe the blocks of ``size`` x ``size`` pixels. ``limits`` are the
    fewest valid pixels, the factor on the noise and the tolerance of the rms distance, the least cosine between ray and
    normal, and the largest deviation of a certain normal.
    """
    needed, sigma, tolerance, min_cosine, most = limits
    count = len(moments)
    accepted, unsure, tilt = np.zeros(count, np.bool_), np.zeros(count, np.bool_), np.empty(count)
    for n in range(count):
        x, y, z = mean[n, 0], mean[n, 1], mean[n, 2]
        spread = noise(z, scale)
        tilt[n] = spread * np.sqrt(12.0) / (max(z, 1e-3) * size / focal * size)
        # The distance of the plane from the camera divided by the distance of the block is the cosine.
        facing = planes[n, 3] > min_cosine * np.sqrt(x * x + y * y + z * z)
        accepted[n] = moments[n, 0] >= needed and planes[n, 4] < sigma * spread + tolerance and facing
        unsure[n] = accepted[n] and tilt[n] > most
    return accepted, unsure, tilt


@kernel
def grow_regions(blocks, order, scale, link_angle, link_noise, link_base, labels, regions):
    """Join neighbouring planar blocks into regions, starting with the first in ``order``; return the number of regions.

    A block joins if it is coplanar with the neighbour from which it is reached, and with the plane of the whole region.
    The region is fitted again as it grows, so it ends where a curved surface leaves the plane. Normals may differ by
    ``link_angle`` radians plus the deviation due to noise. Writes ``labels`` [By, Bx] int32 (initially -1 = none) and
    the moments of the regions into ``regions`` [By * Bx, 10] (initially 0). ``blocks`` is a `Blocks`. ``scale``,
    ``link_noise`` and ``link_base`` give the largest distance between a block's centroid and the other plane.
    """
    moments, planes, accepted, tilt = blocks
    rows, columns = accepted.shape
    stack = np.empty(rows * columns, np.int64)
    plane = np.empty(4)
    count = 0
    for i in range(len(order)):
        seed = order[i]
        r0, c0 = seed // columns, seed % columns
        if not accepted[r0, c0] or labels[r0, c0] >= 0:
            continue
        labels[r0, c0] = count
        region = regions[count]
        # Copied element by element, because array assignments would multiply the compile time.
        for k in range(MOMENTS):
            region[k] = moments[r0, c0, k]
        for k in range(4):
            plane[k] = planes[r0, c0, k]
        refit_at = 2.0 * region[0]
        # Breadth first: the region remains compact, so its plane is well determined as it grows.
        head, tail = 0, 1
        stack[0] = seed
        while head < tail:
            r, c = stack[head] // columns, stack[head] % columns
            head += 1
            here = planes[r, c]
            nb = moments[r, c, 0]
            hx, hy, hz = moments[r, c, 1] / nb, moments[r, c, 2] / nb, moments[r, c, 3] / nb
            for k in range(4):
                rr = r + (1 if k == 0 else -1 if k == 1 else 0)
                cc = c + (1 if k == 2 else -1 if k == 3 else 0)
                if rr < 0 or cc < 0 or rr >= rows or cc >= columns or not accepted[rr, cc] or labels[rr, cc] >= 0:
                    continue
                there = planes[rr, cc]
                slack = tilt[rr, cc]
                cosine = here[0] * there[0] + here[1] * there[1] + here[2] * there[2]
                if cosine < np.cos(min(link_angle + slack + tilt[r, c], MAX_LINK_ANGLE)):
                    continue
                cosine = plane[0] * there[0] + plane[1] * there[1] + plane[2] * there[2]
                if cosine < np.cos(min(link_angle + slack, MAX_LINK_ANGLE)):
                    continue
                nb = moments[rr, cc, 0]
                tx, ty, tz = moments[rr, cc, 1] / nb, moments[rr, cc, 2] / nb, moments[rr, cc, 3] / nb
                limit = link_noise * noise(tz, scale) + link_base
                if abs(here[0] * tx + here[1] * ty + here[2] * tz + here[3]) > limit:
                    continue
                if abs(there[0] * hx + there[1] * hy + there[2] * hz + there[3]) > limit:
                    continue
                if abs(plane[0] * tx + plane[1] * ty + plane[2] * tz + plane[3]) > limit:
                    continue
                labels[rr, cc] = count
                for m in range(MOMENTS):
                    region[m] += moments[rr, cc, m]
                stack[tail] = rr * columns + cc
                tail += 1
                if region[0] >= refit_at:
                    refit(region, plane)
                    refit_at = 1.5 * region[0]
        count += 1
    return count


@kernel
def refine_pixels(depth, lens, choice, scale, pixel_noise, pixel_base, max_depth, min_cosine):
    """Return the label image [H, W]: each pixel gets the closest plane of its own and the eight surrounding blocks.

    The distance must be below ``pixel_noise * noise(z, scale) + pixel_base`` metres, and the cosine between ray and
    normal above ``min_cosine``. Other pixels, and pixels deeper than ``max_depth`` metres, get -1.
    """
    fx, fy, cx, cy = lens
    size, block_labels, planes = choice
    height, width = depth.shape
    rows, columns = block_labels.shape
    labels = np.full((height, width), -1, np.int32)
    near = np.empty(9, np.int64)  # the planes around a block, each once
    for r in range(rows):
        for c in range(columns):
            count = 0
            for rr in range(max(r - 1, 0), min(r + 2, rows)):
                for cc in range(max(c - 1, 0), min(c + 2, columns)):
                    label = block_labels[rr, cc]
                    known = label < 0
                    for n in range(count):
                        known = known or near[n] == label
                    if not known:
                        near[count] = label
                        count += 1
            if count == 0:
                continue
            # The last blocks also have the pixels up to the border of the image.
            for v in range(r * size, (r + 1) * size if r < rows - 1 else height):
                y1 = (v + 0.5 - cy) / fy
                for u in range(c * size, (c + 1) * size if c < columns - 1 else width):
                    z = np.float64(depth[v, u])
                    if not 0.0 < z <= max_depth:
                        continue
                    x, y = (u + 0.5 - cx) / fx * z, y1 * z
                    best = pixel_noise * noise(z, scale) + pixel_base
                    for n in range(count):
                        p = planes[near[n]]
                        residual = abs(p[0] * x + p[1] * y + p[2] * z + p[3])
                        if residual < best and p[3] * p[3] > min_cosine * min_cosine * (x * x + y * y + z * z):
                            best = residual
                            labels[v, u] = near[n]
    return labels
