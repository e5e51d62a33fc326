"""Next Best Sense: FisherRF's gain of the colours and, above all, of the depth ([next_best_sense])."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.fisherrf import fisherrf
from activestructure_gym.features.information import LOG_SCALE, LOGIT, MEAN, diagonal_gain, register_both

COLOR_SHARE, DEPTH_SHARE = 0.1, 1.0  # alpha and beta of the paper


@register_both("next_best_sense")
def next_best_sense(context: FeatureContext) -> np.ndarray:  # [K]
    """I = .1 I_colour + I_depth, each the sum over parameters of H_c / (H_train + lambda), per Gaussian of the map.

    I_colour is `fisherrf`; H of the depth is J^T J of the rendered depth by mean, log-scale and opacity logit (a colour
    moves no depth), with its own H_train, units and lambda. Text: the weighted sum and its alpha = .1, beta = 1 of
    [next_best_sense]; which parameters, and what lambda is in units of, as for `fisherrf`.
    """
    of_depth = diagonal_gain(context, lambda known, seen: seen / known, kinds=(MEAN, LOG_SCALE, LOGIT), of_depth=True)
    return COLOR_SHARE * context.once(fisherrf) + DEPTH_SHARE * of_depth
