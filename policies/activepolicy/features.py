"""Compute ActivePolicy's geometric gain: the share of pixels with uncertain depth.

A pixel counts if three estimates of its rendered depth disagree, or if the map does not cover it.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.median_depth import median_depths
from activestructure_gym.features.registry import FEATURES

# Only a summary of the paper was available. It names these constants without values; all but the first are our choice.
THRESHOLD = 0.25  # tau_u: pixels with a higher U count
SENSITIVITY = 1.0 / 0.05**2  # eta: a term of U is tanh(1 / 2) if the standard deviation of the depths is 5 %
LOG_WEIGHT = 10.0  # gamma: the confidence k is 0.5 alpha if the two depths differ by 10 %
SHARE = 0.5  # omega_s: weight of the depths; the Laplacians have the rest


@FEATURES.register("activepolicy", unit="share of the image", low=0.0, high=1.0)
def activepolicy(context: FeatureContext) -> np.ndarray:  # [K] in 0..1
    """Compute g_geo, the share of pixels with U > tau_u; a pixel that the map does not cover has U = 1.

    U = omega tanh(eta s_d / 2) + (1 - omega) tanh(eta s_l / 2). s_d is the variance of three readings of the depth,
    s_l that of their Laplacians, both over the squared depth. The readings are d_a = sum w d / sum w, the depth d_c of
    the Gaussian at which the transmittance falls to one half, and d_r = d_a^k d_c^(1 - k). The confidence is
    k = alpha / (1 + gamma |log(d_a / d_c)|).

    Source: a summary of [activepolicy]. There, d_c is the depth of the largest weight, k uses a count of Gaussians
    instead of alpha, and the terms are sigmoids: tanh(x / 2) = 2 sigmoid(x) - 1.
    """
    alpha = context.alpha
    covered = alpha > context.coverage_alpha
    mean = context.depth / np.maximum(alpha, 1e-6)
    median = median_depths(context.mapper.map, context.camera, context.world_from_camera)
    median = np.where(covered, median, mean)  # undefined there, and it would disturb the Laplacians of neighbours
    return (~covered | (disagreement(mean, median, alpha) > THRESHOLD)).mean(axis=(1, 2))


def disagreement(mean: np.ndarray, other: np.ndarray, alpha: np.ndarray) -> np.ndarray:  # [K, h, w] each -> U in 0..1
    """Return the disagreement U of three depth readings of every pixel, see `activepolicy`.

    The first reading is ``mean``, the second is ``other`` (both in metres), and the third is computed from both and
    ``alpha``. U has no meaning where one of the depths is 0.
    """
    first, second = np.maximum(mean, 1e-3), np.maximum(other, 1e-3)
    confidence = alpha / (1.0 + LOG_WEIGHT * np.abs(np.log(first / second)))
    readings = np.stack([first, second, first**confidence * second ** (1.0 - confidence)])
    bends = np.stack([ndimage.laplace(image, mode="nearest", axes=(1, 2)) for image in readings])
    spread, bent = readings.var(axis=0) / first**2, bends.var(axis=0) / first**2
    return SHARE * np.tanh(0.5 * SENSITIVITY * spread) + (1.0 - SHARE) * np.tanh(0.5 * SENSITIVITY * bent)
