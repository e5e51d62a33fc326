"""Reduce the noise of a depth image by fitting a plane to each pixel's neighbours on the same surface.

At large distances, the noise of a depth camera exceeds the spacing of Gaussians. Seeds at the measured depth would form
a cloud around a wall, and each new frame would add another cloud, since its noise differs. The plane averages over the
neighbours of a pixel. Neighbours beyond an edge are excluded, so edges are preserved.
"""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry.depth_noise import axial_sigma

_REACHES = (1, 2, 2)  # pixels: window radius of each iteration (measured: 3 or 4 is no better and blurs small objects)
_GATE = 3.0  # sigmas: a neighbour this far from the plane is on another surface (measured against 4)
_IN_LINE = 6.0  # sigmas: largest second difference of three pixels that count as a line (measured)
_MIN_WEIGHT = 2.5  # smallest sum of the weights (at most 1 per pixel) for a fit (own choice)
_MIN_SPREAD = 1e-2  # pixels^4: below this determinant the pixels are collinear and the slope is undefined (own choice)


def on_local_planes(
    depth: np.ndarray,  # [H, W] float32 metres; 0 = no return
    noise_scale: float,  # factor on the axial noise of a Kinect
) -> np.ndarray:  # [H, W] float32 metres
    """Return the depth image with each depth replaced by that of a plane fitted to neighbours on the same surface.

    The fit is by iterated weighted least squares in 1 / z, which is linear in the image along a plane. A neighbour that
    is r sigmas from the plane of the previous iteration has the weight 1 - (r / 3)^2, and 0 from r = 3.

    The first plane is parallel to the image. If more of the 3 x 3 neighbours fit a slanted plane, as on floors, the
    slanted plane is used instead. Its slope along each axis comes from the pixel and two neighbours on one side: the
    side on which these three pixels are closer to a line.

    If the neighbours are collinear, the pixel gets their weighted mean of 1 / z. A pixel without a return or with too
    few neighbours keeps its depth.
    """
    seen = np.where(depth > 0, depth, np.float32(1.0)).astype(np.float64)
    sigma = noise_scale * axial_sigma(seen) / seen**2  # standard deviation of 1 / z, to first order
    inverse = np.where(depth > 0, 1.0 / seen, 0.0)
    return _fitted(inverse, sigma, np.ascontiguousarray(depth, np.float32))


@kernel
def _fitted(inverse: np.ndarray, sigma: np.ndarray, depth: np.ndarray) -> np.ndarray:
    height, width = depth.shape
    fitted = depth.copy()
    for row in range(height):
        for column in range(width):
            if not inverse[row, column] > 0.0:
                continue
            here, least = inverse[row, column], 1.0 / (_GATE * sigma[row, column])
            across, down = _start(inverse, row, column, least)
            for reach in _REACHES:
                # Weighted sums over the neighbours. u and v are the offset in pixels, d = 1 / z.
                n, u, v, d = 0.0, 0.0, 0.0, 0.0
                uu, uv, vv, ud, vd = 0.0, 0.0, 0.0, 0.0, 0.0
                for i in range(max(0, row - reach), min(height, row + reach + 1)):
                    for j in range(max(0, column - reach), min(width, column + reach + 1)):
                        value, x, y = inverse[i, j], float(j - column), float(i - row)
                        off = (value - here - across * x - down * y) * least
                        if not (value > 0.0 and off * off < 1.0):
                            continue
                        k = 1.0 - off * off
                        n, u, v, d = n + k, u + k * x, v + k * y, d + k * value
                        uu, uv, vv = uu + k * x * x, uv + k * x * y, vv + k * y * y
                        ud, vd = ud + k * x * value, vd + k * y * value
                if n < _MIN_WEIGHT:
                    here = inverse[row, column]
                    break
                u, v, d = u / n, v / n, d / n
                uu, uv, vv, ud, vd = uu - n * u * u, uv - n * u * v, vv - n * v * v, ud - n * u * d, vd - n * v * d
                spread = uu * vv - uv * uv
                across, down = 0.0, 0.0
                if spread > _MIN_SPREAD:
                    across, down = (vv * ud - uv * vd) / spread, (uu * vd - uv * ud) / spread
                here = d - across * u - down * v
                if not here > 0.0:
                    here = inverse[row, column]
                    break
            fitted[row, column] = np.float32(1.0 / here)
    return fitted


@kernel
def _start(inverse: np.ndarray, row: int, column: int, least: float) -> tuple[float, float]:
    """Return the slopes of 1 / z per pixel, to the right and down, of the first plane at pixel (row, column).

    ``inverse`` [H, W] is 1 / z. ``least`` is 1 / (3 sigma), so that a difference times ``least`` is 1 at three sigmas.
    """
    height, width = inverse.shape
    across, down = _slope(inverse, row, column, 0, 1, least), _slope(inverse, row, column, 1, 0, least)
    flat, slanted = 0.0, 0.0
    for i in range(max(0, row - 1), min(height, row + 2)):
        for j in range(max(0, column - 1), min(width, column + 2)):
            if inverse[i, j] > 0.0:
                step = inverse[i, j] - inverse[row, column]
                flat += max(0.0, 1.0 - (step * least) ** 2)
                slanted += max(0.0, 1.0 - ((step - across * (j - column) - down * (i - row)) * least) ** 2)
    return (across, down) if slanted > flat else (0.0, 0.0)


@kernel
def _slope(inverse: np.ndarray, row: int, column: int, downwards: int, rightwards: int, least: float) -> float:
    """Return the change of 1 / z per pixel at (row, column), along the axis (``downwards``, ``rightwards``).

    ``inverse`` [H, W] is 1 / z, and ``least`` is 1 / (3 sigma). The change comes from the pixel and two neighbours, on
    the side where the three are closer to a line. It is 0 if neither side is close enough.
    """
    height, width = inverse.shape
    best, slope = _IN_LINE / (_GATE * least), 0.0
    for side in (-1, 1):
        i, j = row + 2 * side * downwards, column + 2 * side * rightwards
        if i < 0 or j < 0 or i >= height or j >= width:
            continue
        middle, end = inverse[row + side * downwards, column + side * rightwards], inverse[i, j]
        off = abs(inverse[row, column] - 2.0 * middle + end)
        if middle > 0.0 and end > 0.0 and off < best:
            best, slope = off, 0.5 * side * (end - inverse[row, column])
    return slope
