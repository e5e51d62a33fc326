"""Find which neighbouring pixels of a depth image are on one surface.

1 / depth is linear along a plane, so two pixels in a line predict the depth of the next one.
"""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel

RIGHT, BELOW = 1, 2  # bits of `surface_links`: the neighbour to the right, and the one below

# Tolerances of `surface_links`, as shares of the depth. Each of two neighbouring pixels defines a plane together with
# the next pixel outwards. If the other pixel is within the first tolerance of one plane, both are on one surface (8 cm
# at 4 m, about three sigmas of a Kinect). If it is beyond the second tolerance of a reliable plane, they are not. In
# between, as where wall and floor meet, one plane suffices (measured).
_SAME_SURFACE, _OTHER_SURFACE = 0.02, 0.04
# Tolerance with which the plane of three pixels must predict the fourth one to prove one surface alone (measured).
_PROVEN = 0.01


@kernel
def surface_links(depth: np.ndarray) -> np.ndarray:  # [H, W] metres, 0 = no return -> [H, W] uint8
    """Return for each pixel the bits `RIGHT` and `BELOW`: whether it is on one surface with these neighbours.

    Each of two neighbours and the next pixel outwards predict the depth of the other one. At least one prediction must
    agree. A prediction that is far off counts against the pair if its own two pixels are on one plane with the pixel
    beyond. Otherwise Gaussians in free space would connect a surface to the edge of another one.
    """
    height, width = depth.shape
    # Bits of `_predict`. Along rows and along columns, pixel (r, c) is at [r + 1, c + 1]; the margin has no bits.
    across = np.zeros((height + 3, width + 3), np.uint8)
    along = np.zeros((height + 3, width + 3), np.uint8)
    inverse = np.empty((3, width))  # 1 / depth of the last three rows
    for row in range(height + 1):
        if row < height:
            for column in range(width):
                inverse[row % 3, column] = 1.0 / depth[row, column]
        if row == 0:
            continue
        # Predict along row - 1, whose neighbouring rows are known.
        here, there, bits = depth[row - 1], inverse[(row - 1) % 3], across[row]
        if width > 2:
            _predict(here[:-2], here[1:-1], here[2:], there[:-2], there[1:-1], 0, bits[2:width])
            _predict(here[2:], here[1:-1], here[:-2], there[2:], there[1:-1], 2, bits[2:width])
        if 1 < row < height:
            bits = along[row, 1 : width + 1]
            _predict(depth[row - 2], here, depth[row], inverse[(row - 2) % 3], there, 0, bits)
            _predict(depth[row], here, depth[row - 2], inverse[row % 3], there, 2, bits)
    links = np.empty((height, width), np.uint8)
    for row in range(height):
        bits, one, two, three, four = across[row + 1], along[row], along[row + 1], along[row + 2], along[row + 3]
        for column in range(width):
            i = column + 1
            right = _joined(bits[i - 1], bits[i], bits[i + 1], bits[i + 2])
            links[row, column] = RIGHT * right | BELOW * _joined(one[i], two[i], three[i], four[i])
    return links


@kernel
def _predict(beyond, near, target, inverse_beyond, inverse_near, shift, bits):  # type: ignore[no-untyped-def]
    """Add two bits from bit ``shift`` on: whether the prediction of ``target`` agrees, and whether it is not far off.

    All arrays are of n pixels. ``beyond``, ``near`` and ``target`` are depths in metres of three pixels in a line.
    """
    agrees, near_enough = np.uint8(1 << shift), np.uint8(2 << shift)
    for i in range(len(near)):
        inverse, depth = 2.0 * inverse_near[i] - inverse_beyond[i], np.float64(target[i])
        off = abs(1.0 / inverse - depth)
        known = (near[i] > 0.0) & (beyond[i] > 0.0) & (depth > 0.0) & (inverse > 0.0)
        bits[i] |= np.uint8((known & (off < _SAME_SURFACE * depth)) * agrees)
        bits[i] |= np.uint8((known & (off < _OTHER_SURFACE * depth)) * near_enough)


@kernel
def _joined(before: int, first: int, second: int, after: int) -> int:
    """Return 1 if two neighbouring pixels are on one surface, else 0, from the bits of four pixels in a line.

    Bits 0 and 1 are of predictions forwards, bits 2 and 3 of predictions backwards (`_predict`).
    """
    agrees = first | (second >> 2)
    denied = (before & ~(first >> 1)) | ((after >> 2) & ~(second >> 3))
    return agrees & ~denied & 1


@kernel
def proven_same_surface(depth: np.ndarray, row: int, column: int, down: int, right: int) -> bool:
    """Return whether pixel (row, column) and its neighbour (row + down, column + right) are on one surface for sure.

    As in `surface_links`, each pixel and the next one outwards predict the depth of the other pixel. Either both
    predictions agree, or one agrees within half the tolerance and its plane contains the next pixel outwards as well.
    """
    agree = 0
    for side in range(2):
        i, j, di, dj = (row, column, -down, -right) if side == 0 else (row + down, column + right, down, right)
        near, target = _depth_at(depth, i, j), _depth_at(depth, i - di, j - dj)
        beyond = _depth_at(depth, i + di, j + dj)
        farther = _depth_at(depth, i + 2 * di, j + 2 * dj)
        if _on_plane(near, beyond, target, _PROVEN) and _on_plane(beyond, farther, near, _PROVEN):
            return True
        agree += _on_plane(near, beyond, target, _SAME_SURFACE)
    return agree == 2


@kernel
def _depth_at(depth: np.ndarray, row: int, column: int) -> float:
    """Return the depth of pixel (row, column) in metres; 0 outside the image."""
    height, width = depth.shape
    inside = row >= 0 and column >= 0 and row < height and column < width
    return float(depth[row, column]) if inside else 0.0


@kernel
def _on_plane(near: float, beyond: float, target: float, share: float) -> bool:
    """Return whether three pixels in a line are on one plane: depths ``beyond``, ``near``, ``target`` in this order.

    The depth predicted for the last one may differ by the fraction ``share`` of ``target``. False if a depth is 0 (no
    return).
    """
    if not (near > 0.0 and beyond > 0.0 and target > 0.0):
        return False
    inverse = 2.0 / near - 1.0 / beyond
    return inverse > 0.0 and abs(1.0 / inverse - target) < share * target
