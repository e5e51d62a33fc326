"""Reduce the resolution of frames for the optimiser."""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry.frame import Frame


def reduced(frame: Frame, factor: int) -> Frame:
    """Return the frame with ``factor`` times fewer pixels per side.

    The colour of a pixel is the mean colour of its block of pixels. Its depth is the lower median of the block's depth
    returns, so it is the depth of one surface. It is 0 if less than half of the block has a return. Raises `ValueError`
    if the image size is not a multiple of ``factor``.
    """
    if factor == 1:
        return frame
    height, width = frame.depth.shape
    if height % factor or width % factor:
        raise ValueError(
            f"an image of {width} x {height} pixels cannot be reduced by {factor}; choose a common divisor"
        )
    rows, columns = height // factor, width // factor
    rgb, depth = _blocks(np.ascontiguousarray(frame.rgb), frame.depth, factor)
    return Frame(
        rgb=rgb,
        depth=depth,
        world_from_camera=frame.world_from_camera,
        camera=frame.camera.resized(columns, rows),
    )


@kernel
def _blocks(rgb, depth, factor):  # type: ignore[no-untyped-def]
    """Return the mean colours [h, w, 3] and the median depths [h, w] of blocks of ``factor`` x ``factor`` pixels."""
    height, width = depth.shape[0] // factor, depth.shape[1] // factor
    colors, depths = np.empty((height, width, 3), np.uint8), np.zeros((height, width), np.float32)
    sums, returns = np.empty(depth.shape[1] * 3, np.int64), np.empty(factor * factor, np.float32)
    size = np.float32(factor * factor)
    for row in range(height):
        sums[:] = 0
        for i in range(row * factor, (row + 1) * factor):
            for j in range(depth.shape[1]):
                for k in range(3):
                    sums[3 * j + k] += rgb[i, j, k]
        for column in range(width):
            for k in range(3):
                total = 0
                for j in range(column * factor, (column + 1) * factor):
                    total += sums[3 * j + k]
                colors[row, column, k] = np.uint8(np.rint(np.float32(total) / size))
            count = 0
            for i in range(row * factor, (row + 1) * factor):
                for j in range(column * factor, (column + 1) * factor):
                    value = depth[i, j]
                    if value != 0.0:  # insert it into the sorted returns
                        at = count
                        while at > 0 and returns[at - 1] > value:
                            returns[at] = returns[at - 1]
                            at -= 1
                        returns[at] = value
                        count += 1
            if 2 * count >= factor * factor:
                depths[row, column] = returns[(count - 1) // 2]
    return colors, depths
