"""A depth image made ready for carving: what pixels without return prove, and minima over blocks of pixels."""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel

# Blocks of the minimum pyramid are at most a sixth of a footprint, which so grows by less than a third.
READS_PER_SIDE = 6
# Lost pixels come singly or in bands a few pixels wide; what is without return on this many squared is truly empty.
_EMPTY_BLOCK = 5
# A lost pixel is taken to be like its neighbours if at least so many of the 8 have a return.
_MIN_NEIGHBOURS = 2


def fill_gaps(
    depth: np.ndarray,  # [H, W] metres, 0 = no return
    sensor_range: float | None,  # metres up to which the sensor returns every surface, None = not known
    *,
    dropouts: bool,  # whether it also loses single returns within that range
) -> np.ndarray:  # [H, W] metres; 0 = proves nothing
    """Distance up to which each pixel's ray is free.

    Without dropouts a pixel without return is free up to the sensor's range. With them only those of a 5 x 5 block
    are; the others are taken to be as near as the nearest of their neighbours.
    """
    gaps = depth <= 0
    if not gaps.any():
        return depth
    if not dropouts:
        return depth if sensor_range is None else np.where(gaps, np.float32(sensor_range), depth)
    known = depth
    if sensor_range is not None:
        known = np.where(solid_gaps(depth), np.float32(sensor_range), depth)
    height, width = depth.shape
    padded = np.pad(np.where(known > 0, known, np.float32(np.inf)), 1, constant_values=np.inf)
    around = np.stack([padded[r : r + height, c : c + width] for r in range(3) for c in range(3)])
    enough = np.isfinite(around).sum(axis=0) >= _MIN_NEIGHBOURS
    return np.where(gaps & enough & (known <= 0), around.min(axis=0), known)


def solid_gaps(
    depth: np.ndarray,  # [H, W] metres, 0 = no return
) -> np.ndarray:  # [H, W] bool
    """Pixels that belong to a block of 5 x 5 pixels without any return (a morphological opening)."""
    gap = depth <= 0
    side = _EMPTY_BLOCK
    centers = gap.copy()
    for axis in range(2):  # what lies beyond the image may be gap
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
    depth: np.ndarray,  # [H, W] metres, 0 = proves nothing
) -> tuple[np.ndarray, np.ndarray]:  # (all levels flat, [L, 3] int64: start, height, width of each level)
    """Minimum over blocks of 2^l x 2^l pixels; a block with a pixel that proves nothing is 0."""
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
    pyramid: np.ndarray,  # in place: level 0 is there
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
