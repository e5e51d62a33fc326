"""Compute the share of uncovered pixels of a view, IG_px of ActiveStructure."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES


@FEATURES.register("pixel", unit="share of the image", low=0.0, high=1.0)
def pixel(context: FeatureContext) -> np.ndarray:  # [K] in 0..1
    """Return IG_px = |{p : M_c(p) = 0}| (Sec. 3.4), the pixels without confident coverage, as a share of the image.

    M_c(p) = 1 where the accumulated alpha exceeds ``coverage_alpha``.
    """
    return (context.alpha <= context.coverage_alpha).mean(axis=(1, 2))
