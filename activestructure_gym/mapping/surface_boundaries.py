"""Find the boundary of the surface around a pixel, which limits the size of a disk.

A disk that extends beyond its surface gives the background the colour and depth of the foreground. So disks are narrow
across a boundary. Along the boundary they are as wide as elsewhere.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping.surface_links import BELOW, RIGHT

# Share of the depth. If a neighbour is deeper than the plane of the previous pixels by more than this, the surface
# bends away from the camera. Seen from the other side, the surface would end there. It is half the tolerance of
# `surface_links`.
_BENT = 0.01
_MAX_REACH_PX = 64  # largest number of pixels tested in each direction


class Boundaries(NamedTuple):
    """Hold the nearest surface boundary of n pixels, as a straight line in the image."""

    distance: np.ndarray  # [n] pixels from the pixel centre to the line; inf if none is within the tested distance
    direction: np.ndarray  # [n, 2] unit vectors (column, row) towards the line; 0 without a line


def nearest_boundaries(
    frame: Frame,
    links: np.ndarray,  # [H, W] uint8 of `surface_links`
    pixels: np.ndarray,  # [n] int64, flat indices
    reach: np.ndarray,  # [n] metres on the surface to test
) -> Boundaries:
    """Return a line per pixel through the two points where the row and the column of the pixel leave its surface."""
    focal = 0.5 * (frame.camera.fx + frame.camera.fy)
    steps = np.ceil(reach * focal / np.maximum(frame.depth.ravel()[pixels], 1e-3) + 0.5)
    ends = _boundary_offsets(frame.depth, links, pixels, np.minimum(steps, _MAX_REACH_PX).astype(np.int64))
    # The line through (h, 0) and (0, v) has the normal (1 / h, 1 / v), whose length is 1 / distance.
    with np.errstate(divide="ignore", invalid="ignore"):
        normal = 1.0 / ends
        length = np.hypot(normal[:, 0], normal[:, 1])
        direction = np.where(length[:, None] > 0, normal / length[:, None], 0.0)
        return Boundaries(1.0 / length, direction)


@kernel
def _boundary_offsets(depth, links, pixels, steps):  # type: ignore[no-untyped-def]
    """Return the signed distances to the nearer end of the surface, along the row and the column of each pixel.

    The result is [n, 2] in pixels; inf = none. ``links`` are those of `surface_links`, ``pixels`` [n] flat indices, and
    ``steps`` [n] the numbers of pixels to test in each direction.
    """
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
                    on_surface = _linked(links, row, column, down, right)
                    if _is_behind(depth, links, row, column, down, right):
                        if step + 0.5 < abs(found[n, axis]):
                            found[n, axis] = sign * (step + 0.5)
                        break
                    if not on_surface:  # a nearer surface occludes the continuation of this surface
                        break
                    row, column = i, j
    return found


@kernel
def _linked(links: np.ndarray, row: int, column: int, down: int, right: int) -> bool:
    """Return whether pixel (row, column) is on one surface with its neighbour (row + down, column + right)."""
    return links[min(row, row + down), min(column, column + right)] & (RIGHT if right else BELOW) != 0


@kernel
def _is_behind(depth: np.ndarray, links: np.ndarray, row: int, column: int, down: int, right: int) -> bool:
    """Return whether the pixel next to (row, column) is behind the surface of that pixel, or has no return.

    The next pixel is at (row + down, column + right). 1 / depth is linear along a plane.
    """
    height, width = depth.shape
    there = depth[row + down, column + right]
    if not there > 0.0:
        return True
    i, j = row - down, column - right
    if i >= 0 and j >= 0 and i < height and j < width:
        if _linked(links, row, column, -down, -right):
            inverse = 2.0 / depth[row, column] - 1.0 / depth[i, j]
            return inverse > 0.0 and there * inverse > 1.0 + _BENT
    return not _linked(links, row, column, down, right) and there > depth[row, column]
