"""Compute Next Best Sense's gain: information of colour and depth, pooled for each Gaussian ([next_best_sense])."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.fisherrf import TIMES
from activestructure_gym.features.information import (
    LAMBDA,
    depth_informed_views,
    informed_views,
    register_both,
    trained,
    trained_of_depth,
)
from activestructure_gym.splatting.fisher import DIAGONAL

COLOR_WEIGHT, DEPTH_WEIGHT = 0.1, 1.0  # alpha and beta of the paper
_COLUMNS = np.array([*DIAGONAL, 21, 22])  # mean, log-scale, logit and colour in `ViewInformation.numbers`


@register_both("next_best_sense")
def next_best_sense(context: FeatureContext) -> np.ndarray:  # [K]
    """Compute the sum over Gaussians of H_c / (H_train + lambda), divided by the number of Gaussians.

    H is 0.1 H_colour + H_depth, each summed over all parameters of a Gaussian (`pooled_color`, `pooled_depth`). lambda
    is 0.01 of the median H_train of the Gaussians that keyframes have seen. The weights alpha = 0.1 and beta = 1 are
    from the text of [next_best_sense], the pooling from [next_best_sense, code].
    """
    known = pooled_color(trained(context)) + pooled_depth(trained_of_depth(context))
    seen = known[known > 0]
    prior = known + LAMBDA * (np.median(seen) if len(seen) else 1.0)
    sums = [
        (pooled_color(color.numbers) / prior[color.indices]).sum()
        + (pooled_depth(depth.numbers) / prior[depth.indices]).sum()
        for color, depth in zip(informed_views(context), depth_informed_views(context))
    ]
    return np.array(sums) / max(1, len(prior))


def pooled_color(numbers: np.ndarray) -> np.ndarray:  # [n, >= 24], see `ViewInformation.numbers` -> [n]
    """Return 0.1 of the information of the colours, summed over mean, log-scale, logit and colours of each Gaussian."""
    return np.asarray(COLOR_WEIGHT * (numbers[:, _COLUMNS] @ TIMES))


def pooled_depth(numbers: np.ndarray) -> np.ndarray:  # [n, >= 24], see `ViewInformation.numbers` -> [n]
    """Return the information of the depth, summed over mean, log-scale and logit of each Gaussian."""
    return np.asarray(DEPTH_WEIGHT * (numbers[:, _COLUMNS[:7]] @ TIMES[:7]))
