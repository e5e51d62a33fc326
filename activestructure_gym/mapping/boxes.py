"""Compute a bounding box for each block of a map: `BLOCK` consecutive Gaussians, which are mostly close in space."""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel

BLOCK = 256  # Gaussians per block
_LANES = 16  # vector width of the processor; the capacity of a map is a multiple of it


def block_boxes(
    parameters: np.ndarray,  # [14, capacity] float32
    count: int,
) -> np.ndarray:  # [B, 7] float64 metres: minimum x, y, z and maximum x, y, z of the means, largest sigma
    """Return the box of each block of `BLOCK` columns. Means that are nan are ignored, since they are not rendered."""
    blocks = -(-count // BLOCK)
    boxes = np.empty((blocks, 7))
    renew_boxes(parameters, count, np.arange(blocks), boxes)
    return boxes


@kernel
def renew_boxes(
    parameters: np.ndarray,  # [14, capacity] float32
    count: int,
    blocks: np.ndarray,  # [b] int64, indices of the blocks to compute
    boxes: np.ndarray,  # [B, 7] changed in place, see `block_boxes`
) -> None:
    """Compute the boxes of some blocks of the map's first ``count`` Gaussians, in place."""
    # Keep one minimum and maximum per vector lane: the compiler vectorises these comparisons, but not a reduction to
    # one.
    least, greatest = np.empty(_LANES, np.float32), np.empty(_LANES, np.float32)
    for block in blocks:
        first, stop = block * BLOCK, min(count, (block + 1) * BLOCK)
        boxes[block, 6] = -np.inf
        for row in (0, 1, 2, 7, 8, 9):
            for lane in range(_LANES):
                least[lane], greatest[lane] = np.float32(np.inf), np.float32(-np.inf)
            # The last vector can include unused columns. They can only enlarge the last box.
            for i in range(first, stop, _LANES):
                for lane in range(_LANES):
                    value = parameters[row, i + lane]
                    least[lane] = value if value < least[lane] else least[lane]
                    greatest[lane] = value if value > greatest[lane] else greatest[lane]
            if row < 3:
                boxes[block, row], boxes[block, 3 + row] = least.min(), greatest.max()
            else:
                boxes[block, 6] = max(boxes[block, 6], greatest.max())
        boxes[block, 6] = np.exp(boxes[block, 6])
