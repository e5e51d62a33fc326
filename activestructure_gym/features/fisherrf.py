"""Score views by FisherRF: Fisher information of a view relative to that of the keyframes ([fisherrf])."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.information import COLOR, LOG_SCALE, LOGIT, MEAN, diagonal_gain, register_both

KINDS = (MEAN, LOG_SCALE, LOGIT, COLOR)
TIMES = np.array([1.0] * 7 + [3.0])  # parameters per column: 3 of the mean, 3 log-scales, opacity; colours share one


@register_both("fisherrf")
def fisherrf(context: FeatureContext) -> np.ndarray:  # [K]
    """Return the sum over parameters of H_c / (H_train + lambda), divided by the number of Gaussians.

    H_c and H_train are the diagonals of the Fisher information of the candidate and of all keyframes. The parameters
    are mean, log-scale, opacity logit and the three colours, whose entries are equal. The rotation is left out, as in
    the released code. That code uses lambda = 1e-6 in raw units; here lambda is 0.01 of the median of H_train.
    """
    return diagonal_gain(context, lambda known, seen: seen / known * TIMES, kinds=KINDS)
