"""Compute the horizontal distance of a view to the nearest keyframe."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.voronoi_node import places


@FEATURES.register("visited_distance", unit="m", low=0.0)
def visited_distance(context: FeatureContext) -> np.ndarray:  # [K] metres
    """Return the horizontal distance from the view's Voronoi node (or the view itself) to the nearest keyframe.

    Every fifth frame is a keyframe and a step is at most 0.1 m. The distance to the path is therefore known within
    0.25 m.
    """
    positions = np.stack([frame.world_from_camera[:2, 3] for frame in context.mapper.keyframes])
    return np.linalg.norm(places(context)[:, None, :2] - positions, axis=2).min(axis=1)
