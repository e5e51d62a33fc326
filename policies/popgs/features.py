"""POp-GS's features: how a view reduces the map's uncertainty, by criteria of optimal experimental design ([popgs]).

With the diagonals h of H_train + lambda and d of H_c, over means and log-scales; the paper's own names differ from the
textbook's, so these are named by formula. Source: [popgs], by its text.
"""

from __future__ import annotations

import numpy as np

import activestructure_gym.policies.popgs.block_features  # noqa: F401  (registers the other features)
from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.information import (
    LAMBDA,
    LOG_SCALE,
    MEAN,
    diagonal_gain,
    diagonal_units,
    informed_views,
    register_both,
    trained,
)


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


@register_both("popgs_min_eig", unit="of what is known in the median")
def popgs_min_eig(context: FeatureContext) -> np.ndarray:  # [K]
    """E-optimality: growth of the least entry of the whole map, min (h + d) - min h.

    That entry is of some Gaussian which hardly any candidate sees, so most maps tell no two views apart by it.
    """
    columns, unit = diagonal_units(context, (MEAN, LOG_SCALE))
    known = trained(context)[:, columns] / unit + LAMBDA
    if not len(known):
        return np.zeros(len(context.world_from_camera))
    least = known.min(axis=1)  # of each Gaussian
    found = []
    for view in informed_views(context):
        after = least.copy()
        after[view.indices] = (known[view.indices] + view.numbers[:, columns] / unit).min(axis=1)
        found.append(after.min() - least.min())
    return np.array(found)
