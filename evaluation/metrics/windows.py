"""Compute SSIM over all Gaussian windows of two images in one compiled pass."""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel

# Source: [ssim]. An 11-tap Gaussian window with a standard deviation of 1.5 pixels, and population covariance.
_SIGMA = 1.5
_OFFSETS = np.arange(11) - 5
_WINDOW = np.exp(-0.5 * (_OFFSETS / _SIGMA) ** 2)
_WINDOW /= _WINDOW.sum()
_C1, _C2 = 0.01**2, 0.03**2  # stabilising constants of [ssim] for values in [0, 1]


def window_means(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # [C], [C]
    """Return two means per channel over all complete windows: SSIM, and its contrast-structure term alone.

    ``x`` and ``y`` are contiguous [H, W, C] float64 in [0, 1] with at least 11 x 11 pixels.
    """
    height, width, channels = x.shape
    sums = np.zeros((2, channels))
    flat = (height, width * channels)
    _window_sums(x.reshape(flat), y.reshape(flat), channels, _WINDOW, sums)
    windows = (height - len(_WINDOW) + 1) * (width - len(_WINDOW) + 1)
    return sums[0] / windows, sums[1] / windows


@kernel
def _window_sums(
    x: np.ndarray,  # [H, W * C] in [0, 1]
    y: np.ndarray,  # [H, W * C] in [0, 1]
    channels: int,
    taps: np.ndarray,  # [11] weights of the window in one axis
    sums: np.ndarray,  # [2, C] increased
) -> None:
    """Add SSIM (row 0) and the contrast-structure term (row 1) of all windows to ``sums``.

    The window is applied down the columns, then along the rows. Inner loops run over adjacent numbers and vectorise.
    """
    height, width = x.shape
    inside = width - 10 * channels
    # x^2 + y^2 and x y of the 11 rows under the window; row r of the image is stored at index r % 11.
    squares, crossed = np.empty((11, width)), np.empty((11, width))
    down = np.empty((4, width))
    window = np.empty((4, inside))
    full, contrast = np.empty(inside), np.empty(inside)
    for i in range(height - 10):
        for row in range(i + 10 if i > 0 else 0, i + 11):
            _products(x[row], y[row], squares[row % 11], crossed[row % 11])
        _down(x, i, height, taps, down[0])
        _down(y, i, height, taps, down[1])
        _down(squares, i, 11, taps, down[2])
        _down(crossed, i, 11, taps, down[3])
        for part in range(4):
            row, out, c = down[part], window[part], channels
            _first(out, taps, row, row[c:], row[2 * c :])
            _next(out, taps[3:], row[3 * c :], row[4 * c :], row[5 * c :], row[6 * c :])
            _next(out, taps[7:], row[7 * c :], row[8 * c :], row[9 * c :], row[10 * c :])
        _compare(window[0], window[1], window[2], window[3], full, contrast)
        for j in range(0, inside, channels):
            for c in range(channels):
                sums[0, c] += full[j + c]
                sums[1, c] += contrast[j + c]


@kernel
def _products(x: np.ndarray, y: np.ndarray, squares: np.ndarray, crossed: np.ndarray) -> None:
    """Write x^2 + y^2 and x y of one row; all arrays are [W * C]."""
    for j in range(len(x)):
        squares[j] = x[j] * x[j] + y[j] * y[j]
        crossed[j] = x[j] * y[j]


@kernel
def _down(rows: np.ndarray, i: int, count: int, taps: np.ndarray, out: np.ndarray) -> None:
    """Write the sum of the image rows i to i + 10, weighted by ``taps`` [11], to ``out`` [W * C].

    Row r of the image is stored in ``rows`` [count, W * C] at index r % ``count``.
    """
    _first(out, taps, rows[i % count], rows[(i + 1) % count], rows[(i + 2) % count])
    for k in (3, 7):
        r = i + k
        _next(out, taps[k:], rows[r % count], rows[(r + 1) % count], rows[(r + 2) % count], rows[(r + 3) % count])


# Several taps per pass keep the partial sums in registers. The taps are always added in the order of the window.
@kernel
def _first(out: np.ndarray, taps: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
    """Write the sum of three arrays, weighted by the first three ``taps``."""
    ta, tb, tc = taps[0], taps[1], taps[2]
    for j in range(len(out)):
        out[j] = ta * a[j] + tb * b[j] + tc * c[j]


@kernel
def _next(out: np.ndarray, taps: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> None:
    """Add the sum of four arrays, weighted by the first four ``taps``, to ``out``."""
    ta, tb, tc, td = taps[0], taps[1], taps[2], taps[3]
    for j in range(len(out)):
        out[j] = out[j] + ta * a[j] + tb * b[j] + tc * c[j] + td * d[j]


@kernel
def _compare(
    mean_x: np.ndarray,
    mean_y: np.ndarray,
    squares: np.ndarray,
    crossed: np.ndarray,
    full: np.ndarray,
    contrast: np.ndarray,
) -> None:
    """Write SSIM and its contrast-structure term of every window, from the window's weighted means.

    The arrays are [N]: means of x, y, x^2 + y^2 (``squares``) and x y (``crossed``), and the two results.
    """
    for j in range(len(full)):
        means = mean_x[j] * mean_x[j] + mean_y[j] * mean_y[j]
        product = mean_x[j] * mean_y[j]
        contrast[j] = (2.0 * (crossed[j] - product) + _C2) / (squares[j] - means + _C2)
        full[j] = (2.0 * product + _C1) / (means + _C1) * contrast[j]
