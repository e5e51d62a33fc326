"""Compute the compiled loops of plane detection over labelled pixels: segments, their moments and coplanar ones.

Moments, ``lens``, planes and limits have the forms of `detection_kernels`.
"""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.planes.detection_kernels import MOMENTS, add_point, fit_planes, noise


@kernel
def rename(labels, table):
    """Replace each label of the image ``labels`` [H, W] by its entry in ``table``, in place; -1 remains."""
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            if labels[v, u] >= 0:
                labels[v, u] = table[labels[v, u]]


@kernel
def explained_shares(depth, lens, labels, planes, scale, limit_noise, limit_base):
    """Return for each label the fraction of its pixels that are also on the plane of a label with more pixels.

    ``labels`` [H, W] is the label image, and ``planes`` [S, 5] the planes. A pixel is on a plane if its distance is
    below ``limit_noise * noise(z, scale) + limit_base`` metres.
    """
    fx, fy, cx, cy = lens
    count = len(planes)
    sizes = np.zeros(count, np.int64)
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            if labels[v, u] >= 0:
                sizes[labels[v, u]] += 1
    explained = np.zeros(count)
    for v in range(depth.shape[0]):
        y1 = (v + 0.5 - cy) / fy
        for u in range(depth.shape[1]):
            label = labels[v, u]
            if label < 0:
                continue
            z = np.float64(depth[v, u])
            x, y = (u + 0.5 - cx) / fx * z, y1 * z
            limit = limit_noise * noise(z, scale) + limit_base
            for other in range(count):
                if sizes[other] > sizes[label]:
                    p = planes[other]
                    if abs(p[0] * x + p[1] * y + p[2] * z + p[3]) < limit:
                        explained[label] += 1.0
                        break
    for label in range(count):
        explained[label] /= max(sizes[label], 1)
    return explained


@kernel
def segment_moments(depth, lens, labels, count):
    """Return the moments [S, 10] of the pixels of every label, for ``count`` = S labels."""
    fx, fy, cx, cy = lens
    moments = np.zeros((count, MOMENTS))
    for v in range(depth.shape[0]):
        y1 = (v + 0.5 - cy) / fy
        for u in range(depth.shape[1]):
            label = labels[v, u]
            if label >= 0:
                z = np.float64(depth[v, u])
                add_point(moments[label], (u + 0.5 - cx) / fx * z, y1 * z, z)
    return moments


@kernel
def segment_areas(depth, lens, labels, planes, min_cosine):
    """Return the area of every label in m^2: the sum of z^2 / (fx fy c) over its pixels.

    ``labels`` [H, W] is the label image, and ``planes`` [S, 5] the planes. c is the absolute dot product of normal and
    pixel ray (with z = 1), at least ``min_cosine``.
    """
    fx, fy, cx, cy = lens
    areas = np.zeros(len(planes))
    for v in range(depth.shape[0]):
        y1 = (v + 0.5 - cy) / fy
        for u in range(depth.shape[1]):
            label = labels[v, u]
            if label >= 0:
                z = np.float64(depth[v, u])
                p = planes[label]
                # For the ray with z = 1, this value converts image area to area on the plane.
                cosine = abs(p[0] * (u + 0.5 - cx) / fx + p[1] * y1 + p[2])
                areas[label] += z * z / (fx * fy * max(cosine, min_cosine))
    return areas


@kernel
def _square_distance(second, count, mean, plane):
    """Return the mean squared distance of a set of points to a plane, from the moments of the points.

    ``second`` [10] are the moments, ``count`` the number of points and ``mean`` [3] their centroid.
    """
    x, y, w, d = plane[0], plane[1], plane[2], plane[3]
    n = max(count, 1.0)
    form = x * x * second[4] + 2 * x * y * second[5] + 2 * x * w * second[6]
    form += y * y * second[7] + 2 * y * w * second[8] + w * w * second[9]
    return form / n + d * (2.0 * (x * mean[0] + y * mean[1] + w * mean[2]) + d)


@kernel
def _coplanar_gap(i, j, moments, planes, mean, scale, limits):
    """Return the distance in metres by which segments i and j differ from one plane; inf if they are not coplanar.

    It is the distance of the smaller segment's centroid to the larger one's plane, or of the larger one's centroid to
    the smaller one's plane divided by ``merge_back``, if this is greater. ``limits`` are thresholds of
    `PlaneDetectionConfig`. ``moments`` [S, 10], ``planes`` [S, 5] and ``mean`` [S, 3] describe the segments.
    """
    sigma, tolerance, merge_back, cosine, wide_sigma, wide_tolerance, wide_cosine, reach = limits
    p, q, m, n = planes[i], planes[j], mean[i], mean[j]
    turn = p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
    if not (turn > cosine or turn > wide_cosine):
        return np.inf
    if not np.sqrt((m[0] - n[0]) ** 2 + (m[1] - n[1]) ** 2 + (m[2] - n[2]) ** 2) < reach:
        return np.inf
    out = abs(p[0] * n[0] + p[1] * n[1] + p[2] * n[2] + p[3])  # centroid of segment j to the plane of segment i
    back = abs(q[0] * m[0] + q[1] * m[1] + q[2] * m[2] + q[3])
    larger = moments[i, 0] >= moments[j, 0]
    gap = max(out, back / merge_back) if larger else max(back, out / merge_back)
    if turn > cosine and gap < tolerance + sigma * noise(max(m[2], n[2]), scale):
        return gap
    # Mean squared distance of the points of the smaller segment to the plane of the larger one.
    if larger:
        square, z = _square_distance(moments[j], moments[j, 0], n, p), n[2]
    else:
        square, z = _square_distance(moments[i], moments[i, 0], m, q), m[2]
    if turn > wide_cosine and square < (wide_tolerance + wide_sigma * noise(z, scale)) ** 2:
        return gap
    return np.inf


@kernel
def merge_coplanar(moments, scale, limits):
    """Merge coplanar segments by adding up their moments [S, 10], closest pair first, with a fit after every merge.

    Returns the mask [S] of remaining rows, and for each row [S] the row into which it was merged. ``scale`` and
    ``limits`` are described at `_coplanar_gap`.
    """
    count = len(moments)
    label, alive = np.arange(count), moments[:, 0] >= 3
    planes, mean = fit_planes(moments)
    gaps = np.full((count, count), np.inf)
    for i in range(count):
        for j in range(count):
            if i != j and alive[i] and alive[j]:
                gaps[i, j] = _coplanar_gap(i, j, moments, planes, mean, scale, limits)
    while True:
        least, i, j = np.inf, -1, -1
        for a in range(count):
            for b in range(count):
                if gaps[a, b] < least:
                    least, i, j = gaps[a, b], a, b
        if i < 0:
            return alive, label
        alive[j] = False
        for m in range(MOMENTS):
            moments[i, m] += moments[j, m]
        plane, middle = fit_planes(moments[i : i + 1])
        planes[i, :], mean[i, :] = plane[0], middle[0]
        for a in range(count):
            if label[a] == j:
                label[a] = i
            gaps[a, j] = gaps[j, a] = np.inf
            gap = _coplanar_gap(i, a, moments, planes, mean, scale, limits) if alive[a] and a != i else np.inf
            gaps[a, i] = gaps[i, a] = gap


@kernel
def spread_points(depth, lens, labels, steps, ends):
    """Return every ``steps[k]``-th pixel of label k in row-major order as a camera-frame point [ends[-1], 3] float64.

    The points of label k end at row ``ends[k]``.
    """
    fx, fy, cx, cy = lens
    points = np.empty((ends[-1], 3))
    found, place = np.zeros(len(ends), np.int64), np.zeros(len(ends), np.int64)
    place[1:] = ends[:-1]
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            k = labels[v, u]
            if k < 0:
                continue
            if found[k] % steps[k] == 0:
                z = np.float64(depth[v, u])
                points[place[k], 0] = (u + 0.5 - cx) / fx * z
                points[place[k], 1] = (v + 0.5 - cy) / fy * z
                points[place[k], 2] = z
                place[k] += 1
            found[k] += 1
    return points
