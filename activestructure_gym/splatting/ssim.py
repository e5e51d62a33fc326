"""Structural similarity and its gradient, compiled (11 taps, sigma 1.5, zero padding; Wang et al. 2004).

Derivative as in ``../shared/research/backbones.md`` 4.6. Only the sum of the two variances enters SSIM, so four blurs
make the value and three the gradient.
"""

from __future__ import annotations

import numpy as np
from numba import njit

_TAPS = np.exp(-0.5 * ((np.arange(11) - 5) / 1.5) ** 2)
SSIM_TAPS = (_TAPS / _TAPS.sum()).astype(np.float32)  # [11]
C1 = np.float32(0.01**2)
C2 = np.float32(0.03**2)


def ssim_and_gradient(
    image: np.ndarray,  # [H, W, 3] float32 0..1
    target: np.ndarray,  # [H, W, 3] float32 0..1
) -> tuple[float, np.ndarray]:
    """Mean SSIM over pixels and channels, and its derivative by ``image`` ``[H, W, 3]``."""
    if image.shape != target.shape or image.ndim != 3:
        raise ValueError(f"two images [H, W, 3] of one size are needed, got {image.shape} and {target.shape}")
    gradient = np.empty(image.shape, np.float32)
    total = 0.0
    for channel in range(image.shape[2]):
        x = np.ascontiguousarray(image[..., channel], dtype=np.float32)
        y = np.ascontiguousarray(target[..., channel], dtype=np.float32)
        value, gradient[..., channel] = _ssim_plane(x, y, SSIM_TAPS)
        total += value
    gradient /= image.size
    return total / image.size, gradient


@njit(cache=True, nogil=True, fastmath=True)
def _blur(source, taps):
    """Separable convolution, zero outside the image."""
    height, width = source.shape
    padded = np.zeros((height, width + 10), np.float32)
    padded[:, 5:-5] = source
    across = np.zeros((height + 10, width), np.float32)
    for row in range(height):
        for k in range(11):
            tap = taps[k]
            for column in range(width):
                across[row + 5, column] += tap * padded[row, column + k]
    result = np.zeros((height, width), np.float32)
    for row in range(height):
        for k in range(11):
            tap = taps[k]
            for column in range(width):
                result[row, column] += tap * across[row + k, column]
    return result


@njit(cache=True, nogil=True, fastmath=True)
def _ssim_plane(x, y, taps):
    """Sum of SSIM over one channel and its derivative by ``x``."""
    height, width = x.shape
    mean_x, mean_y = _blur(x, taps), _blur(y, taps)
    squares, product = _blur(x * x + y * y, taps), _blur(x * y, taps)
    by_mean = np.empty((height, width), np.float32)
    by_variance = np.empty((height, width), np.float32)
    by_covariance = np.empty((height, width), np.float32)
    total = 0.0
    two = np.float32(2.0)
    for row in range(height):
        for column in range(width):
            mx, my = mean_x[row, column], mean_y[row, column]
            n1 = two * mx * my + C1
            n2 = two * (product[row, column] - mx * my) + C2
            d1 = mx * mx + my * my + C1
            d2 = squares[row, column] - mx * mx - my * my + C2
            inverse = np.float32(1.0) / (d1 * d2)
            value = n1 * n2 * inverse
            total += value
            by_covariance[row, column] = two * n1 * inverse
            by_variance[row, column] = -value / d2
            by_mean[row, column] = two * (my * (n2 - n1) * inverse + mx * value * (d1 - d2) * inverse)
    gradient = _blur(by_mean, taps)
    blurred_variance = _blur(by_variance, taps)
    blurred_covariance = _blur(by_covariance, taps)
    for row in range(height):
        for column in range(width):
            gradient[row, column] += (
                two * x[row, column] * blurred_variance[row, column] + y[row, column] * blurred_covariance[row, column]
            )
    return total, gradient
