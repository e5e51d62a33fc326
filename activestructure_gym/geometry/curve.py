"""Order points along a Morton (Z-order) curve, which keeps points that are close in space close in the order."""

from __future__ import annotations

import numpy as np

_BITS = 16  # bits per axis of a cell's index: each axis is divided into 2^16 cells


def curve_order(points: np.ndarray) -> np.ndarray:  # [N] indices
    """Return the indices that sort finite points [N, 3] along a Morton curve through their bounding box.

    Points with the same cell of the 2^16 x 2^16 x 2^16 grid keep their order.
    """
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
    """Move bit i of each number to bit 3 i, for the lowest 16 bits, so that three numbers can be interleaved."""
    for shift, mask in ((16, 0x0000FF0000FF), (8, 0x00F00F00F00F), (4, 0x0C30C30C30C3), (2, 0x249249249249)):
        value = (value | (value << np.uint64(shift))) & np.uint64(mask)
    return value
