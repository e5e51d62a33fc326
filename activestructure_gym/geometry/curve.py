"""Order points in space along a Morton curve, so that neighbours stay close."""

from __future__ import annotations

import numpy as np

_BITS = 16  # per axis


def curve_order(points: np.ndarray) -> np.ndarray:  # [N] indices
    """Return the indices that sort finite points [N, 3] along a Morton curve through their bounding box."""
    if not len(points):
        return np.zeros(0, np.int64)
    low = points.min(axis=0)
    extent = max(float((points.max(axis=0) - low).max()), 1e-9)
    cell = ((points - low) * ((2**_BITS - 1) / extent)).astype(np.uint64)
    code = np.zeros(len(points), np.uint64)
    for axis in range(3):
        code |= _spread(cell[:, axis]) << np.uint64(axis)
    return np.argsort(code, kind="stable")


def _spread(value: np.ndarray) -> np.ndarray:
    """Spread the lowest 16 bits of each number to every third bit."""
    for shift, mask in ((16, 0x0000FF0000FF), (8, 0x00F00F00F00F), (4, 0x0C30C30C30C3), (2, 0x249249249249)):
        value = (value | (value << np.uint64(shift))) & np.uint64(mask)
    return value
