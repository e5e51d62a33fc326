"""Compute image metrics between a rendered and a true view: PSNR, SSIM, MS-SSIM, and the depth error."""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.evaluation.metrics.windows import window_means

# Minimum mean squared error: it limits the PSNR of equal images to 100 dB, far above the PSNR of 8-bit rounding.
_MIN_MSE = 1e-10

# Exponents of the five scales: [ms_ssim], section 3.2.
_SCALE_WEIGHTS = np.array([0.0448, 0.2856, 0.3001, 0.2363, 0.1333])
TAPS = 11  # side of the SSIM window in pixels, at every scale
# The window must fit into the image after four halvings.
MS_SSIM_SIDE = (TAPS - 1) * 2 ** (len(_SCALE_WEIGHTS) - 1) + 1  # pixels of the smaller side: 161


def psnr(rendered: np.ndarray, true: np.ndarray) -> float:  # dB
    """Compute the PSNR from one mean squared error over all pixels and channels, at most 100 dB.

    Parameters
    ----------
    rendered, true
        Images of equal shape with values in [0, 1].

    Returns
    -------
    float
        PSNR in dB.

    Raises
    ------
    ValueError
        An image has whole numbers, such as 0 to 255.

    Examples
    --------
    >>> psnr(np.zeros((4, 4, 3)), np.zeros((4, 4, 3)))
    100.0
    """
    error = np.mean((_floats(rendered) - _floats(true)) ** 2)
    return float(-10.0 * np.log10(max(float(error), _MIN_MSE)))


def channel_psnr(rendered: np.ndarray, true: np.ndarray) -> float:  # dB
    """Compute the PSNR of each channel of two images [H, W, C], and return their mean.

    Source: [activegamer, code]. The PSNR of a channel is at most 100 dB. The mean is never below `psnr`, and far above
    it if one channel has a much smaller error than another.
    """
    x, y = np.ascontiguousarray(rendered, np.float64), np.ascontiguousarray(true, np.float64)
    sums = np.zeros(x.shape[2])
    _squared_errors(x.reshape(-1, x.shape[2]), y.reshape(-1, x.shape[2]), sums)
    errors = sums / (x.shape[0] * x.shape[1])
    return float(np.mean(-10.0 * np.log10(np.maximum(errors, _MIN_MSE))))


def ssim(rendered: np.ndarray, true: np.ndarray) -> float:
    """Compute the mean structural similarity of two images over all complete windows and channels.

    The result equals that of scikit-image with ``gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
    data_range=1``.

    Parameters
    ----------
    rendered, true
        Images [H, W, C] of equal shape with values in [0, 1], at least 11 x 11 pixels.

    Returns
    -------
    float
        Similarity of at most 1; equal images have 1.

    Raises
    ------
    ValueError
        The images differ in shape, or are smaller than the window.

    Notes
    -----
    Source: Wang et al., "Image quality assessment: from error visibility to structural similarity", IEEE TIP 2004,
    eq. 13.

    Examples
    --------
    >>> ssim(np.full((16, 16, 3), 0.5), np.full((16, 16, 3), 0.5))
    1.0
    """
    x, y = _pair(rendered, true)
    return float(window_means(x, y)[0].mean())


def ms_ssim(rendered: np.ndarray, true: np.ndarray) -> float | None:
    """Compute the multi-scale structural similarity of two images.

    The result equals ``pytorch_msssim.ms_ssim(data_range=1)``: [ms_ssim] with five scales, each half as wide as the
    previous one, and negative terms set to 0. The tables of SplaTAM and ActiveGAMER call it SSIM.

    Parameters
    ----------
    rendered, true
        Images [H, W, C] of equal shape with values in [0, 1].

    Returns
    -------
    float or None
        Similarity of at most 1; None if a side is shorter than 161 pixels.

    Notes
    -----
    Source: Wang et al., "Multiscale structural similarity for image quality assessment", Asilomar 2003, eq. 7.
    """
    return similarities(rendered, true)[1]


def similarities(rendered: np.ndarray, true: np.ndarray) -> tuple[float, float | None]:
    """Return `ssim` and `ms_ssim` of two images [H, W, C] in [0, 1]; the finest scale of both is computed once."""
    x, y = _pair(rendered, true)
    full, contrast = window_means(x, y)  # [C] each
    single = float(full.mean())
    if min(x.shape[:2]) < MS_SSIM_SIDE:
        return single, None
    product = np.maximum(contrast, 0.0) ** _SCALE_WEIGHTS[0]
    for scale, weight in enumerate(_SCALE_WEIGHTS[1:], start=1):
        x, y = halved(x), halved(y)
        full, contrast = window_means(x, y)
        term = full if scale == len(_SCALE_WEIGHTS) - 1 else contrast
        product = product * np.maximum(term, 0.0) ** weight
    return single, float(product.mean())


def halved(image: np.ndarray) -> np.ndarray:  # [ceil(H / 2), ceil(W / 2), C]
    """Return the image [H, W, C] at half the size, by the means of 2 x 2 pixels.

    An odd side is first padded with a zero at both ends, as in pytorch_msssim.
    """
    height, width, channels = image.shape
    if height % 2 or width % 2:
        image = np.pad(image, ((height % 2,) * 2, (width % 2,) * 2, (0, 0)))
    half = np.empty(((height + 1) // 2, (width + 1) // 2, channels))
    _halve(np.ascontiguousarray(image, np.float64), half)
    return half


@kernel
def _halve(image: np.ndarray, half: np.ndarray) -> None:
    """Write the means of 2 x 2 pixels of ``image`` [2 H, 2 W, C] to ``half`` [H, W, C]."""
    for i in range(half.shape[0]):
        for j in range(half.shape[1]):
            for c in range(half.shape[2]):
                left = image[2 * i, 2 * j, c] + image[2 * i + 1, 2 * j, c]
                half[i, j, c] = 0.25 * (left + image[2 * i, 2 * j + 1, c] + image[2 * i + 1, 2 * j + 1, c])


@kernel
def _squared_errors(x: np.ndarray, y: np.ndarray, sums: np.ndarray) -> None:
    """Add the squared differences of ``x`` and ``y`` [N, C] to ``sums`` [C]."""
    for i in range(x.shape[0]):
        for c in range(x.shape[1]):
            error = x[i, c] - y[i, c]
            sums[c] += error * error


def depth_l1(
    rendered: np.ndarray,  # [H, W] metres, 0 = no Gaussian
    true: np.ndarray,  # [H, W] metres, 0 = no surface
) -> float | None:  # metres
    """Compute the mean absolute depth error over the pixels with a true surface.

    A pixel without Gaussians counts with its full true depth, as in the evaluations of SplaTAM and ActiveGAMER. So
    missing regions of the map are never an advantage.

    Parameters
    ----------
    rendered
        [H, W] metres along the optical axis; 0 = no Gaussian at this pixel.
    true
        [H, W] metres along the optical axis; 0 = no surface.

    Returns
    -------
    float or None
        Mean error in metres; None if no pixel has a true surface.

    Examples
    --------
    >>> depth_l1(np.array([[1.0, 0.0, 5.0]]), np.array([[1.5, 2.0, 0.0]]))
    1.25
    """
    mask = true > 0
    if not mask.any():
        return None
    return float(np.abs(rendered[mask].astype(np.float64) - true[mask].astype(np.float64)).mean())


def _floats(image: np.ndarray) -> np.ndarray:
    """Return an image as contiguous float64; raise `ValueError` for whole numbers, whose range is not [0, 1]."""
    array = np.asarray(image)
    if array.dtype.kind not in "fc":
        raise ValueError(f"expected an image of floats in [0, 1], got {array.dtype}: divide 0 to 255 by 255")
    return np.ascontiguousarray(array, np.float64)


def _pair(rendered: np.ndarray, true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return both images [H, W, C] by `_floats`; raise `ValueError` if shapes differ or are below 11 x 11."""
    x, y = _floats(rendered), _floats(true)
    if x.shape != y.shape or x.ndim != 3:
        raise ValueError(f"expected two images [H, W, C] of one shape, got {x.shape} and {y.shape}")
    if min(x.shape[:2]) < TAPS:
        raise ValueError(f"SSIM needs at least {TAPS} x {TAPS} pixels, got {x.shape[1]} x {x.shape[0]}")
    return x, y
