"""Compute ActiveGS's utility of a view: unexplored space and surface with low confidence."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.blending import blended
from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.unexplored import ANY_ALPHA, unexplored
from activestructure_gym.features.view_directions import REACH, ViewDirections, view_directions

EXPLORATION = 1000.0  # lambda: weight of the share of unexplored voxels; the term of the confidence has weight 1
UNSEEN_DEPTH = 2.5  # metres, D of a pixel that the map does not cover


@FEATURES.register("confidence", unit="weighted sum of shares", low=0.0)
def confidence(context: FeatureContext) -> np.ndarray:  # [K] >= 0
    """Compute U = 1000 #visible unexplored voxels / #voxels + mean over pixels of (1 - C) D / 5 m (ActiveGS).

    C is the confidence of the Gaussians, blended like a colour over 0. D is the rendered depth. A pixel without any
    Gaussian has D = 2.5 m; a pixel deeper than 5 m counts 0. Source: [active_gs, code].
    """
    values = gaussian_confidence(view_directions(context.mapper)).astype(np.float32)
    sure = np.minimum(blended(context, values), 1.0)
    depth = np.where(context.alpha > ANY_ALPHA, context.depth / np.maximum(context.alpha, ANY_ALPHA), UNSEEN_DEPTH)
    doubt = np.where(depth > REACH, 0.0, (1.0 - sure) * depth / REACH)
    return EXPLORATION * unexplored(context) + doubt.mean(axis=(1, 2))


def gaussian_confidence(seen: ViewDirections) -> np.ndarray:  # [N] 0..1
    """Return the confidence C = min(e^(1 - |mean v|) s, 1) of each Gaussian.

    v is the unit direction to a keyframe that faces the Gaussian's front within 5 m. s is the sum of
    max(0, 1 - distance / 5 m) n v over these keyframes, where n is the Gaussian's normal (`ViewDirections.nearness`).
    """
    return np.minimum(np.exp(1.0 - seen.concentration) * seen.nearness, 1.0)
