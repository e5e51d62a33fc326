"""Test all Gaussians of a map in one compiled pass each.

Numpy versions would spend most of their time on temporary arrays of the size of the map.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.mapping.gaussian_map import ROWS

CHUNK = 1024  # Gaussians per chunk, as in the rasteriser; the sums of a chunk fit into the first-level cache


class MeasuredDepth(NamedTuple):
    """Hold a depth image and its camera as one kernel argument."""

    depth: np.ndarray  # [H, W] float32 metres; 0 = no return
    camera_from_world: np.ndarray  # [3, 4] float32
    intrinsics: np.ndarray  # [4] float32 pixels: fx, fy, cx, cy


@kernel
def unfit(
    parameters: np.ndarray,  # [14, capacity] float32
    count: int,
    least_logit: float,  # logit of the smallest allowed opacity
    most_log_scale: float,  # logarithm of the largest allowed sigma in metres
    changed: np.ndarray,  # [chunks] bool, chunks of 1024 Gaussians to test
) -> np.ndarray:  # [n] int64 columns, increasing
    """Return the Gaussians in ``changed`` chunks that are too transparent, too large along an axis, or not finite."""
    found, at = np.empty(min(count, CHUNK * changed.sum()), np.int64), 0
    total = np.empty(CHUNK, np.float32)
    for first in range(0, count, CHUNK):
        if not changed[first // CHUNK]:
            continue
        length = min(CHUNK, count - first)
        for i in range(length):
            total[i] = np.float32(0.0)
        for row in range(ROWS):
            values = parameters[row, first : first + length]
            for i in range(length):
                total[i] += values[i]  # a sum is not finite if one of its values is not
        for i in range(length):
            column = first + i
            fits = (
                np.isfinite(total[i])
                & (parameters[10, column] >= least_logit)
                & (parameters[7, column] <= most_log_scale)
                & (parameters[8, column] <= most_log_scale)
                & (parameters[9, column] <= most_log_scale)
            )
            if not fits:
                found[at] = column
                at += 1
    return found[:at].copy()


@kernel
def faces_away(parameters: np.ndarray, i: int, x: float, y: float, z: float) -> bool:
    """Return whether Gaussian i is a disk whose normal points away from the world point (x, y, z) in metres.

    The normal is the third axis. A Gaussian is a disk if its third scale is smaller than the second one.
    """
    if not parameters[9, i] < parameters[8, i]:
        return False
    p, q, r, s = parameters[3, i], parameters[4, i], parameters[5, i], parameters[6, i]
    towards = (
        (q * s + p * r) * (x - parameters[0, i])
        + (r * s - p * q) * (y - parameters[1, i])
        + np.float32(0.5) * (p * p + s * s - q * q - r * r) * (z - parameters[2, i])
    )
    return towards <= np.float32(0.0)


@kernel
def too_wide(
    parameters: np.ndarray,  # [14, n] float32
    count: int,
    unseen: np.ndarray,  # [chunks] bool, chunks of 1024 Gaussians to skip
    measured_depth: MeasuredDepth,
    largest: np.ndarray,  # [H, W] float32 metres, largest allowed sigma at each pixel
) -> np.ndarray:  # [count] bool
    """Return a mask of the Gaussians on the measured surface that are wider than allowed at their pixel.

    A Gaussian is on the surface if its mean is within one sigma of the measured depth; sigma is its middle scale. Disks
    that face away are not in the mask, because they belong to the other side of a thin object.
    """
    depth, m, intrinsics = measured_depth
    eye = np.zeros(3, np.float32)
    for k in range(3):
        eye[k] = -(m[0, k] * m[0, 3] + m[1, k] * m[1, 3] + m[2, k] * m[2, 3])
    found, height, width = np.zeros(count, np.bool_), depth.shape[0], depth.shape[1]
    for chunk in range(len(unseen)):
        if unseen[chunk]:
            continue
        for i in range(chunk * CHUNK, min(count, (chunk + 1) * CHUNK)):
            a, b, c = parameters[0, i], parameters[1, i], parameters[2, i]
            z = m[2, 0] * a + m[2, 1] * b + m[2, 2] * c + m[2, 3]
            if not z > 0.0:
                continue
            u = intrinsics[0] * (m[0, 0] * a + m[0, 1] * b + m[0, 2] * c + m[0, 3]) / z + intrinsics[2]
            v = intrinsics[1] * (m[1, 0] * a + m[1, 1] * b + m[1, 2] * c + m[1, 3]) / z + intrinsics[3]
            if not (u >= 0.0 and v >= 0.0 and u < width and v < height):
                continue
            measured = depth[int(v), int(u)]
            p, q, r = parameters[7, i], parameters[8, i], parameters[9, i]
            middle = np.exp(max(min(p, q), min(max(p, q), r)))
            wide = measured > 0.0 and middle > largest[int(v), int(u)] and abs(z - measured) <= middle
            found[i] = wide and not faces_away(parameters, i, eye[0], eye[1], eye[2])
    return found
