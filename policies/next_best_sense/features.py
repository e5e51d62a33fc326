"""Compute Next Best Sense's gain: FisherRF's gain of the colours plus that of the depth ([next_best_sense])."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.fisherrf import fisherrf
from activestructure_gym.features.information import LOG_SCALE, LOGIT, MEAN, diagonal_gain, register_both

COLOR_SHARE, DEPTH_SHARE = 0.1, 1.0  # alpha and beta of the paper


@register_both("next_best_sense")
def next_best_sense(context: FeatureContext) -> np.ndarray:  # [K]
    """Compute I = 0.1 I_colour + I_depth, each the sum of H_c / (H_train + lambda), per Gaussian of the map.

    I_colour is the feature `fisherrf`. For I_depth, H is J^T J of the rendered depth with respect to mean, log-scale
    and opacity logit, with its own H_train and units; lambda is 0.01 of a unit in both. The sum and its weights alpha =
    0.1 and beta = 1 are from the text of [next_best_sense].
    """
    of_depth = diagonal_gain(context, lambda known, seen: seen / known, kinds=(MEAN, LOG_SCALE, LOGIT), of_depth=True)
    return COLOR_SHARE * context.once(fisherrf) + DEPTH_SHARE * of_depth
