"""POp-GS's features: how a view reduces the map's uncertainty, by criteria of optimal experimental design ([popgs]).

With the diagonals h of H_train + lambda and d of H_c, over means and log-scales; the paper's own names differ from the
textbook's, so these are named by formula. Source: [popgs], by its text.
"""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.information import diagonal_gain, register_both


@register_both("popgs_logdet")
def popgs_logdet(context: FeatureContext) -> np.ndarray:  # [K]
    """D-optimality: sum of log(1 + d / h), by how much the uncertain volume shrinks."""
    # A product first, since logarithms are dear. Six factors stay far below the largest float64.
    return diagonal_gain(context, lambda known, seen: np.log(np.prod(1.0 + seen / known, axis=1)))


@register_both("popgs_cov_trace")
def popgs_cov_trace(context: FeatureContext) -> np.ndarray:  # [K]
    """Sum of 1 / h - 1 / (h + d), by how much the variances shrink: "T-optimality" there, A in textbooks."""
    return diagonal_gain(context, lambda known, seen: seen / (known * (known + seen)))


@register_both("popgs_info_trace")
def popgs_info_trace(context: FeatureContext) -> np.ndarray:  # [K]
    """Sum of d, whatever is known already: "A-optimality" there, T in textbooks. Likes what was seen and is near."""
    return diagonal_gain(context, lambda known, seen: seen)


@register_both("popgs_min_eig")
def popgs_min_eig(context: FeatureContext) -> np.ndarray:  # [K]
    """E-optimality of every Gaussian: sum of the growth of its least informed parameter, min (h + d) - min h.

    The least entry of the whole map, as in the paper, is that of some Gaussian which no candidate sees: the same
    number for all of them.
    """
    return diagonal_gain(context, lambda known, seen: (known + seen).min(axis=1) - known.min(axis=1))
