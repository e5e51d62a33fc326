"""FisherRF's feature: the Fisher information of a view relative to that of the keyframes ([fisherrf])."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.information import COLOR, LOG_SCALE, LOGIT, MEAN, diagonal_gain, register_both

KINDS = (MEAN, LOG_SCALE, LOGIT, COLOR)
TIMES = np.array([1.0] * 7 + [3.0])  # the three colours have one entry


@register_both("fisherrf")
def fisherrf(context: FeatureContext) -> np.ndarray:  # [K]
    """Sum over parameters of H_c / (H_train + lambda), per Gaussian of the map.

    Parameters are mean, log-scale, opacity logit and the three colours, which all have the same information; not the
    rotation, as in the released selector. Lambda there is 1e-6 of no unit.
    """
    return diagonal_gain(context, lambda known, seen: seen / known * TIMES, kinds=KINDS)
