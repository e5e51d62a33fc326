"""Reduce the resolution of frames for the optimiser."""

from __future__ import annotations

import numpy as np

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
    rgb = frame.rgb.reshape(rows, factor, columns, factor, 3).mean(axis=(1, 3), dtype=np.float32)
    blocks = frame.depth.reshape(rows, factor, columns, factor).transpose(0, 2, 1, 3).reshape(rows, columns, -1)
    blocks = np.sort(blocks, axis=-1)  # pixels without a return come first
    returns = np.count_nonzero(blocks, axis=-1)
    middle = blocks.shape[-1] - returns + np.maximum(returns - 1, 0) // 2
    depth = np.take_along_axis(blocks, np.minimum(middle, blocks.shape[-1] - 1)[..., None], axis=-1)[..., 0]
    depth[2 * returns < blocks.shape[-1]] = 0.0
    return Frame(
        rgb=np.rint(rgb).astype(np.uint8),
        depth=np.ascontiguousarray(depth, dtype=np.float32),
        world_from_camera=frame.world_from_camera,
        camera=frame.camera.resized(columns, rows),
    )
