"""Compute ActiveGAMER's information gain: the share of pixels of a view that the map does not cover."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES


@FEATURES.register("uncovered", unit="share of the image", low=0.0, high=1.0)
def uncovered(context: FeatureContext) -> np.ndarray:  # [K] in 0..1
    """Compute the share of pixels p with D_c(p) <= 0, where D_c is the map's accumulated depth (ActiveGAMER).

    A pixel is covered if it has any opacity. In the feature `pixel`, the opacity must exceed ``coverage_alpha``.
    ActiveGAMER also leaves out pixels without surface in the simulator's true mesh. This is ground truth, so it is not
    used here.
    Source: [activegamer, code].
    """
    return (context.depth <= 0.0).mean(axis=(1, 2))
