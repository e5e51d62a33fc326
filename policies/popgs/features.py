"""Compute POp-GS's gains: the reduction of the map's uncertainty, by criteria of optimal experimental design ([popgs]).

H_train and H_c are the Fisher information of all keyframes and of the candidate about means and log-scales of the
Gaussians. h is the diagonal of H_train + lambda, and d is the diagonal of H_c. Both are in units of the median of
H_train. The paper's names of the criteria differ from the names in textbooks, so the features are named by their
formulas. Source: [popgs], by its text.
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
    """Compute the sum of log(1 + d / h), per Gaussian of the map: the log volume removed from the uncertainty.

    h is the information of the keyframes about a parameter, d that of the candidate. Source: [popgs], D-optimality.
    """
    # The product needs one logarithm per Gaussian. Six factors cannot overflow float64.
    return diagonal_gain(context, lambda known, seen: np.log(np.prod(1.0 + seen / known, axis=1)))


@register_both("popgs_cov_trace")
def popgs_cov_trace(context: FeatureContext) -> np.ndarray:  # [K]
    """Compute the sum of 1 / h - 1 / (h + d), per Gaussian of the map: the reduction of the variances.

    h is the information of the keyframes about a parameter, d that of the candidate. Source: [popgs], where it is
    called T-optimality; textbooks call it A-optimality.
    """
    return diagonal_gain(context, lambda known, seen: seen / (known * (known + seen)))


@register_both("popgs_info_trace")
def popgs_info_trace(context: FeatureContext) -> np.ndarray:  # [K]
    """Compute the sum of d over all parameters, divided by the number of Gaussians: the trace of the information.

    d is the information of the candidate about a parameter. Apart from its unit, the sum does not depend on the
    keyframes. It is large for views near mapped surface. Source: [popgs], where it is called A-optimality; textbooks
    call it T-optimality.
    """
    return diagonal_gain(context, lambda known, seen: seen)


@register_both("popgs_min_eig", unit="of what is known in the median")
def popgs_min_eig(context: FeatureContext) -> np.ndarray:  # [K]
    """Compute min (h + d) - min h, the growth of the smallest information in the map, in units of the median one.

    h is the information of the keyframes about a parameter, d that of the candidate. The smallest entry belongs to a
    Gaussian that hardly any candidate sees, so in most maps the gain is 0 for all candidates. Source: [popgs],
    E-optimality.
    """
    columns, unit = diagonal_units(context, (MEAN, LOG_SCALE))
    known = trained(context)[:, columns] / unit + LAMBDA
    if not len(known):
        return np.zeros(len(context.world_from_camera))
    least = known.min(axis=1)  # [N]
    found = []
    for view in informed_views(context):
        after = least.copy()
        after[view.indices] = (known[view.indices] + view.numbers[:, columns] / unit).min(axis=1)
        found.append(after.min() - least.min())
    return np.array(found)
