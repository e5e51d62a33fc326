"""The Gaussian windows of SSIM, as one compiled pass over two images."""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel

# As Wang et al. (2004) define it: an 11-tap Gaussian window of 1.5 pixels, population covariance.
_SIGMA = 1.5
_OFFSETS = np.arange(11) - 5
_WINDOW = np.exp(-0.5 * (_OFFSETS / _SIGMA) ** 2)
_WINDOW /= _WINDOW.sum()
_C1, _C2 = 0.01**2, 0.03**2  # for values in 0..1


def window_means(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # [C], [C]
    """Means per channel over all whole windows of the similarity, and of its contrast and structure part alone.

    ``x`` and ``y`` are [H, W, C] float64 in 0..1, contiguous, at least 11 x 11 pixels.
    """
    height, width, channels = x.shape
    sums = np.zeros((2, channels))
    flat = (height, width * channels)
    _window_sums(x.reshape(flat), y.reshape(flat), channels, _WINDOW, sums)
    windows = (height - len(_WINDOW) + 1) * (width - len(_WINDOW) + 1)
    return sums[0] / windows, sums[1] / windows


@kernel
def _window_sums(
    x: np.ndarray,  # [H, W * C]
    y: np.ndarray,
    channels: int,
    taps: np.ndarray,
    sums: np.ndarray,  # [2, C], added to
) -> None:
    """Rows first, then columns; every inner loop runs over neighbouring numbers, so that all of them vectorise."""
    height, width = x.shape
    size = len(taps)
    inside = width - (size - 1) * channels
    products = np.empty((2, height, width))  # x^2 + y^2, and x y: more is not needed
    for i in range(height):
        for j in range(width):
            products[0, i, j] = x[i, j] * x[i, j] + y[i, j] * y[i, j]
            products[1, i, j] = x[i, j] * y[i, j]
    down = np.empty((4, width))
    window = np.empty((4, inside))
    full, contrast = np.empty(inside), np.empty(inside)
    for i in range(height - size + 1):
        down[:] = 0.0
        for k in range(size):
            tap, row = taps[k], i + k
            for j in range(width):
                down[0, j] += tap * x[row, j]
            for j in range(width):
                down[1, j] += tap * y[row, j]
            for j in range(width):
                down[2, j] += tap * products[0, row, j]
            for j in range(width):
                down[3, j] += tap * products[1, row, j]
        window[:] = 0.0
        for part in range(4):
            for k in range(size):
                tap, shift = taps[k], k * channels
                for j in range(inside):
                    window[part, j] += tap * down[part, j + shift]
        for j in range(inside):
            mean_x, mean_y = window[0, j], window[1, j]
            squares = mean_x * mean_x + mean_y * mean_y
            product = mean_x * mean_y
            contrast[j] = (2.0 * (window[3, j] - product) + _C2) / (window[2, j] - squares + _C2)
            full[j] = (2.0 * product + _C1) / (squares + _C1) * contrast[j]
        for j in range(0, inside, channels):
            for c in range(channels):
                sums[0, c] += full[j + c]
                sums[1, c] += contrast[j + c]
