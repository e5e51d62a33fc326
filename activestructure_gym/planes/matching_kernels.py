"""Compute the compiled loops of plane matching: the planes that match a segment, and distances along rays."""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.planes.surface_kernels import cell_of


@kernel
def qualifying(planes, normal, offset, centroid, limits):
    """Return the planes that match a segment, as rows [M, 3]: distance (metres), index, flag for distant centroids.

    A plane matches if it satisfies the coplanar or the near mode of `matching.MatchingConfig`. ``limits`` are the
    thresholds of both modes. ``planes`` [N, 7] holds normal, offset and centroid of each plane.

    The distance is the larger of two distances: segment centroid to plane, and plane centroid to the segment's plane.
    The flag is 1 if only the coplanar mode is satisfied and the centroids are farther apart than its reach. The caller
    accepts such a plane only if its surface touches the segment. Normals face the camera, so the two faces of a thin
    wall never match.
    """
    flat_cosine, flat_distance, lever, flat_reach, near_cosine, near_distance, near_reach = limits
    found, total = np.empty((len(planes), 3)), 0
    for n in range(len(planes)):
        p = planes[n]
        cosine = p[0] * normal[0] + p[1] * normal[1] + p[2] * normal[2]
        if not (cosine > flat_cosine or cosine > near_cosine):
            continue
        to_node = abs(p[0] * centroid[0] + p[1] * centroid[1] + p[2] * centroid[2] + p[3])
        to_segment = abs(p[4] * normal[0] + p[5] * normal[1] + p[6] * normal[2] + offset)
        reach = np.sqrt((p[4] - centroid[0]) ** 2 + (p[5] - centroid[1]) ** 2 + (p[6] - centroid[2]) ** 2)
        near = cosine > near_cosine and to_node < near_distance and reach < near_reach
        flat = cosine > flat_cosine and to_node < flat_distance and to_segment < flat_distance + lever * reach
        if near or flat:
            found[total, 0], found[total, 1] = max(to_node, to_segment), n
            found[total, 2] = 0.0 if near or reach <= flat_reach else 1.0
            total += 1
    return found[:total]


@kernel
def near_pairs(planes, min_cosine, max_distance):
    """Return the pairs of planes [M, 2], in both orders, that are nearly parallel and of which one is near the other.

    Their normals have at least the cosine ``min_cosine``, and a centroid is within ``max_distance`` metres of the other
    plane. ``planes`` [N, 7] holds normal, offset and centroid of each plane.
    """
    found, total = np.empty((len(planes) * len(planes), 2), np.int64), 0
    for n in range(len(planes)):
        p = planes[n]
        for m in range(len(planes)):
            q = planes[m]
            if m == n or not p[0] * q[0] + p[1] * q[1] + p[2] * q[2] > min_cosine:
                continue
            away = abs(q[0] * p[4] + q[1] * p[5] + q[2] * p[6] + q[3])
            back = abs(p[0] * q[4] + p[1] * q[5] + p[2] * q[6] + p[3])
            if min(away, back) < max_distance:
                found[total, 0], found[total, 1] = n, m
                total += 1
    return found[:total]


@kernel
def depth_gaps(points, eye, normal, offset, grid, low, seen, cell):
    """Return the distances [M] between points [P, 3] and a plane along their rays from ``eye``, times the rays' slant.

    Distances are in metres. Only rays are included that meet the plane in front of the eye, in a seen cell of its grid.
    At grazing incidence the noise of the plane moves the intersection along the ray. The slant, the cosine between ray
    and normal, compensates this; it is at least 0.2 (78 degrees). The plane has ``normal`` [3] and ``offset``;
    ``grid``, ``low``, ``seen`` and ``cell`` are the parts of its `surface.SurfaceGrid`.
    """
    gaps, total = np.empty(len(points)), 0
    height = eye[0] * normal[0] + eye[1] * normal[1] + eye[2] * normal[2] + offset
    for n in range(len(points)):
        x, y, z = points[n, 0] - eye[0], points[n, 1] - eye[1], points[n, 2] - eye[2]
        facing = x * normal[0] + y * normal[1] + z * normal[2]
        along = -height / facing  # 1 if the ray meets the plane at the point
        if not 0.0 < along < np.inf:
            continue
        r, c = cell_of(eye[0] + along * x, eye[1] + along * y, eye[2] + along * z, grid, cell)
        r, c = r - low[0], c - low[1]
        if 0 <= r < seen.shape[0] and 0 <= c < seen.shape[1] and seen[r, c]:
            length = np.sqrt(x * x + y * y + z * z)
            slant = min(max(abs(facing) / max(length, 1e-9), 0.2), 1.0)
            gaps[total] = abs(along - 1.0) * length * slant
            total += 1
    return gaps[:total]
