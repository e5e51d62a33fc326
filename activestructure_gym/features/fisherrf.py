"""Score views by FisherRF: Fisher information of a view relative to that of the keyframes ([fisherrf])."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.information import COLOR, LOG_SCALE, LOGIT, MEAN, diagonal_gain, register_both

KINDS = (MEAN, LOG_SCALE, LOGIT, COLOR)
TIMES = np.array([1.0] * 7 + [3.0])  # number of parameters per entry: the three colours share one


@register_both("fisherrf")
def fisherrf(context: FeatureContext) -> np.ndarray:  # [K]
    """Return the sum over parameters of H_c / (H_train + lambda), divided by the number of Gaussians.

    Parameters are mean, log-scale, opacity logit and the three colours, whose entries are equal. The rotation is left
    out, as in the released selector. That selector uses lambda = 1e-6 without a unit.
    """
    return diagonal_gain(context, lambda known, seen: seen / known * TIMES, kinds=KINDS)
