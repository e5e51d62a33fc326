"""Distance of a view's place in the plane to the nearest keyframe."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.voronoi_node import places


@FEATURES.register("visited_distance", unit="m", low=0.0)
def visited_distance(context: FeatureContext) -> np.ndarray:  # [K] metres
    """Distance in the plane from the view's Voronoi node (or itself) to the nearest keyframe's position.

    Every fifth frame is a keyframe and a step is 0.1 m, so the way between them is known to a quarter of a metre.
    """
    way = np.stack([frame.world_from_camera[:2, 3] for frame in context.mapper.keyframes])
    return np.linalg.norm(places(context)[:, None, :2] - way, axis=2).min(axis=1)
