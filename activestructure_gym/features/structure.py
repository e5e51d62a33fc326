"""The sum of the deficits of the planes in sight, as one number per view (Eq. 13 without phases)."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES


@FEATURES.register("structure", unit="sum of deficits, 0 to 1 each", low=0.0)
def structure(context: FeatureContext) -> np.ndarray:  # [K]
    """Sum of the information deficits gamma_i (Eq. 10) of the planes the view sees: Eq. 13 with all alpha_i = 1.

    `activestructure_gym.policies.activestructure` needs the sum per type and phase, and takes visibility and deficits
    from the observation instead.
    """
    return context.visible @ context.planes.state.deficit
