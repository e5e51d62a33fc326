"""Prepare a depth image for carving: distance up to which each ray is free, and minima over blocks of pixels."""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel

# A footprint is read as at most 6 blocks of pixels per side. The blocks then exceed it by less than a third.
READS_PER_SIDE = 6
# Side length in pixels. Lost returns are single pixels or bands a few pixels wide, so a block of this size without any
# return shows empty space.
_EMPTY_BLOCK = 5
# A lost pixel gets the smallest depth of its 8 neighbours if at least this many of them have a return.
_MIN_NEIGHBOURS = 2


def fill_gaps(
    depth: np.ndarray,  # [H, W] metres, 0 = no return
    sensor_range: float | None,  # metres up to which the sensor returns every surface; None = unknown
    *,
    dropouts: bool,  # whether the sensor also loses single returns within that range
    unmeasured: np.ndarray | None = None,  # [H, W] bool, as in `Frame`
) -> np.ndarray:  # [H, W] metres; 0 = unknown
    """Return the distance up to which the ray of each pixel is free.

    Without dropouts, a measured pixel without return is free up to ``sensor_range``. With dropouts this holds only
    inside blocks of 5 x 5 pixels without return; other lost pixels get the smallest depth of their neighbours.
    """
    gaps = depth <= 0
    if not gaps.any():
        return depth
    measured = gaps if unmeasured is None else gaps & ~unmeasured
    if not dropouts:
        return depth if sensor_range is None else np.where(measured, np.float32(sensor_range), depth)
    known = depth
    if sensor_range is not None:
        known = np.where(solid_gaps(depth) & measured, np.float32(sensor_range), depth)
    height, width = depth.shape
    padded = np.pad(np.where(known > 0, known, np.float32(np.inf)), 1, constant_values=np.inf)
    around = np.stack([padded[r : r + height, c : c + width] for r in range(3) for c in range(3)])
    enough = np.isfinite(around).sum(axis=0) >= _MIN_NEIGHBOURS
    return np.where(gaps & enough & (known <= 0), around.min(axis=0), known)


def solid_gaps(
    depth: np.ndarray,  # [H, W] metres, 0 = no return
) -> np.ndarray:  # [H, W] bool
    """Return a mask of the pixels that are in a block of 5 x 5 pixels without any return (a morphological opening)."""
    gap = depth <= 0
    side = _EMPTY_BLOCK
    centers = gap.copy()
    for axis in range(2):  # pixels beyond the image count as gaps
        lines = np.moveaxis(centers, axis, 0)
        padded = np.pad(lines, ((side // 2, side // 2), (0, 0)), constant_values=True)
        for shift in range(side):
            lines &= padded[shift : shift + len(lines)]
    for axis in range(2):
        lines = np.moveaxis(centers, axis, 0)
        padded = np.pad(lines, ((side // 2, side // 2), (0, 0)))
        for shift in range(side):
            lines |= padded[shift : shift + len(lines)]
    return centers & gap


def minimum_pyramid(
    depth: np.ndarray,  # [H, W] metres, 0 = unknown
) -> tuple[np.ndarray, np.ndarray]:  # all levels in one flat array, [L, 3] int64: start, height, width of each level
    """Return the minimum depth of each block of 2^l x 2^l pixels, for levels l = 0, 1, ...; 0 if a pixel is unknown."""
    height, width = depth.shape
    levels, size = [(0, height, width)], height * width
    while min(height, width) > 2 * READS_PER_SIDE:
        height, width = (height + 1) // 2, (width + 1) // 2
        levels.append((size, height, width))
        size += height * width
    table, pyramid = np.array(levels, dtype=np.int64), np.empty(size, np.float32)
    pyramid[: depth.size] = depth.ravel()
    _fill_pyramid(pyramid, table)
    return pyramid, table


@kernel
def _fill_pyramid(
    pyramid: np.ndarray,  # output; level 0 is given
    levels: np.ndarray,  # [L, 3] start, height, width
) -> None:
    for level in range(1, len(levels)):
        below, rows, columns = levels[level - 1]
        start, height, width = levels[level]
        for v in range(height):
            top, bottom = below + 2 * v * columns, below + min(2 * v + 1, rows - 1) * columns
            for u in range(width):
                left, right = 2 * u, min(2 * u + 1, columns - 1)
                upper = min(pyramid[top + left], pyramid[top + right])
                pyramid[start + v * width + u] = min(upper, min(pyramid[bottom + left], pyramid[bottom + right]))
