"""ActiveGAMER's information gain."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES


@FEATURES.register("uncovered", unit="share of the image", low=0.0, high=1.0)
def uncovered(context: FeatureContext) -> np.ndarray:  # [K] in 0..1
    """|{p : D_c(p) <= 0}| as a share of the image, D_c the accumulated depth of the map (ActiveGAMER, CVPR 2025).

    A pixel counts as covered as soon as any opacity reaches it, where `pixel` asks for ``coverage_alpha``. ActiveGAMER
    also excuses pixels in which the simulator's true mesh has nothing; that is ground truth, so nobody gets it here.
    Source: [activegamer, code].
    """
    return (context.depth <= 0.0).mean(axis=(1, 2))
