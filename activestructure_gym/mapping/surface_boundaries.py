"""How far a disk may reach: where the surface in a frame ends, and which way.

A disk that hangs over the border of its surface paints what is behind it in the colour and depth of what is in front.
So towards a border disks are narrow, and along it as wide as elsewhere.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping.density import joined

# A neighbour that lies deeper than the plane of the pixels before it by more than this share bends away: there the
# surface ends for who looks from the other side. Half of what still counts as one surface.
_BENT = 0.01
_MAX_REACH_PX = 64  # pixels that are looked at in each direction


class Borders(NamedTuple):
    """The nearest border of the surface at some pixels, as a line in the image."""

    distance: np.ndarray  # [n] pixels from the pixel's middle, inf = none as far as was looked
    direction: np.ndarray  # [n, 2] unit vectors (columns, rows) towards it, 0 without one


def nearest_borders(
    frame: Frame,
    pixels: np.ndarray,  # [n] int64, flat index
    reach: np.ndarray,  # [n] metres, how far to look
) -> Borders:
    """Borders by where the rows and the columns through each pixel leave its surface."""
    focal = 0.5 * (frame.camera.fx + frame.camera.fy)
    steps = np.ceil(reach * focal / np.maximum(frame.depth.ravel()[pixels], 1e-3) + 0.5)
    ends = _ends(frame.depth, pixels, np.minimum(steps, _MAX_REACH_PX).astype(np.int64))
    # The line through (h, 0) and (0, v) has the normal (1 / h, 1 / v), whose length is 1 / distance.
    with np.errstate(divide="ignore", invalid="ignore"):
        normal = 1.0 / ends
        length = np.hypot(normal[:, 0], normal[:, 1])
        direction = np.where(length[:, None] > 0, normal / length[:, None], 0.0)
        return Borders(1.0 / length, direction)


@kernel
def _ends(depth: np.ndarray, pixels: np.ndarray, steps: np.ndarray) -> np.ndarray:  # [n, 2] pixels, signed, inf = none
    """How far the surface goes on along the row and along the column, to the nearer of the two ends."""
    height, width = depth.shape
    found = np.full((len(pixels), 2), np.inf)
    for n in range(len(pixels)):
        for axis in range(2):
            for sign in (1, -1):
                right, down = (sign, 0) if axis == 0 else (0, sign)
                row, column = pixels[n] // width, pixels[n] % width
                for step in range(steps[n]):
                    i, j = row + down, column + right
                    if not (i >= 0 and j >= 0 and i < height and j < width):
                        break
                    on_it = joined(depth, min(row, i), min(column, j), abs(down), abs(right))
                    if _lies_behind(depth, row, column, down, right, on_it):
                        if step + 0.5 < abs(found[n, axis]):
                            found[n, axis] = sign * (step + 0.5)
                        break
                    if not on_it:  # before a nearer surface this one goes on, unseen
                        break
                    row, column = i, j
    return found


@kernel
def _lies_behind(depth: np.ndarray, row: int, column: int, down: int, right: int, on_it: bool) -> bool:
    """Whether the next pixel lies behind the surface of this one, or nowhere: 1 / z is linear along a plane."""
    height, width = depth.shape
    there = depth[row + down, column + right]
    if not there > 0.0:
        return True
    i, j = row - down, column - right
    if i >= 0 and j >= 0 and i < height and j < width:
        if joined(depth, min(row, i), min(column, j), abs(down), abs(right)):
            inverse = 2.0 / depth[row, column] - 1.0 / depth[i, j]
            return inverse > 0.0 and there * inverse > 1.0 + _BENT
    return not on_it and there > depth[row, column]
