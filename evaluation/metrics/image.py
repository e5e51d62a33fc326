"""PSNR, SSIM and depth error between a rendered and a true view."""

from __future__ import annotations

import numpy as np

# SSIM as Wang et al. (2004) define it: an 11-tap Gaussian window of 1.5 pixels, population covariance.
_TAPS = 11
_SIGMA = 1.5
_C1, _C2 = 0.01**2, 0.03**2  # for values in 0..1

# Two equal images have no finite PSNR; an 8-bit truth cannot be met better than this anyway.
_SMALLEST_MSE = 1e-10


def psnr(rendered: np.ndarray, true: np.ndarray) -> float:  # dB
    """Pooled PSNR: one mean squared error over all pixels and channels of two images in 0..1; at most 100 dB."""
    error = np.mean((np.asarray(rendered, np.float64) - np.asarray(true, np.float64)) ** 2)
    return float(-10.0 * np.log10(max(float(error), _SMALLEST_MSE)))


def ssim(rendered: np.ndarray, true: np.ndarray) -> float:
    """Mean structural similarity of two images [H, W, C] in 0..1, over all whole windows and the channels.

    Equals scikit-image's with ``gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1``.
    Raises ValueError below 11 x 11 pixels, where no whole window fits.
    """
    import cv2

    x, y = np.asarray(rendered, np.float64), np.asarray(true, np.float64)
    if x.shape != y.shape or x.ndim != 3:
        raise ValueError(f"expected two images [H, W, C] of one shape, got {x.shape} and {y.shape}")
    if min(x.shape[:2]) < _TAPS:
        raise ValueError(f"SSIM needs at least {_TAPS} x {_TAPS} pixels, got {x.shape[1]} x {x.shape[0]}")
    offset = np.arange(_TAPS) - _TAPS // 2
    taps = np.exp(-0.5 * (offset / _SIGMA) ** 2)
    taps /= taps.sum()
    inside = slice(_TAPS // 2, -(_TAPS // 2))

    def blurred(image: np.ndarray) -> np.ndarray:
        return cv2.sepFilter2D(image, cv2.CV_64F, taps, taps)[inside, inside]

    mean_x, mean_y = blurred(x), blurred(y)
    variance_x = blurred(x * x) - mean_x**2
    variance_y = blurred(y * y) - mean_y**2
    covariance = blurred(x * y) - mean_x * mean_y
    similarity = ((2 * mean_x * mean_y + _C1) * (2 * covariance + _C2)) / (
        (mean_x**2 + mean_y**2 + _C1) * (variance_x + variance_y + _C2)
    )
    return float(similarity.mean())


def depth_l1(
    rendered: np.ndarray,  # [H, W] metres, 0 = the map has nothing there
    true: np.ndarray,  # [H, W] metres, 0 = no surface
) -> float | None:  # metres
    """Mean depth error over the pixels where there is a surface; None where there is none.

    A hole counts with the whole true depth, as in SplaTAM's and ActiveGAMER's evaluation, so that leaving a region
    out is never an advantage.
    """
    mask = true > 0
    if not mask.any():
        return None
    return float(np.abs(rendered[mask].astype(np.float64) - true[mask].astype(np.float64)).mean())
