"""What a noisy depth image says about the surface: at every pixel a plane through the neighbours that lie on it.

Far away the noise of a depth camera is larger than the spacing of Gaussians. Seeded as measured, a wall becomes a cloud
around itself, and every further look adds another, for nothing of it stands where the wall is measured next. Neighbours
that show one plane measure it together; those beyond an edge are left out, so edges stay where they are.
"""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry.depth_noise import axial_sigma

_REACHES = (1, 2, 2)  # pixels to each side, round by round (measured: 3 or 4 win nothing and blur what is small)
_GATE = 3.0  # sigmas from the plane of the round before beyond which a neighbour shows something else (measured: 4)
_LEAST_WEIGHT = 2.5  # of all neighbours, of 1 each: below it there is no plane (own choice)
_LEAST_SPREAD = 1e-2  # of their places, pixels^4: below it they are in one line, and no slope is known (own choice)


def on_local_planes(
    depth: np.ndarray,  # [H, W] float32 metres; 0 = no return
    noise_scale: float,  # times the axial noise of a Kinect
) -> np.ndarray:  # [H, W] float32 metres
    """Depth of the plane that a pixel and its neighbours show: least squares in 1 / z, which is linear along a plane.

    The first round takes the plane parallel to the image through the pixel, the others that of the round before; a
    neighbour at r sigmas from it has the weight 1 - (r / 3)^2, none from 3 on. A pixel without a plane around it, and
    one without a return, keeps what was measured.
    """
    seen = np.where(depth > 0, depth, np.float32(1.0)).astype(np.float64)
    sigma = noise_scale * axial_sigma(seen) / seen**2  # of 1 / z, to first order
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
            here, across, down = inverse[row, column], 0.0, 0.0
            for reach in _REACHES:
                least = 1.0 / (_GATE * sigma[row, column])
                # Sums of weights, places and values of the neighbours: u, v pixels from here, d = 1 / z.
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
                if n < _LEAST_WEIGHT:
                    here = inverse[row, column]
                    break
                u, v, d = u / n, v / n, d / n
                uu, uv, vv, ud, vd = uu - n * u * u, uv - n * u * v, vv - n * v * v, ud - n * u * d, vd - n * v * d
                spread = uu * vv - uv * uv
                across, down = 0.0, 0.0
                if spread > _LEAST_SPREAD:
                    across, down = (vv * ud - uv * vd) / spread, (uu * vd - uv * ud) / spread
                here = d - across * u - down * v
                if not here > 0.0:
                    here = inverse[row, column]
                    break
            fitted[row, column] = np.float32(1.0 / here)
    return fitted
