"""How far a place lies from where the agent has been."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.base import GAINS, GainContext
from activestructure_gym.features.voronoi_node import places


@GAINS.register("visited_distance")
def visited_distance(context: GainContext) -> np.ndarray:  # [K] metres
    """Distance in the plane from the view's Voronoi node (or itself) to the nearest keyframe's position.

    Every fifth frame is a keyframe and a step is 0.1 m, so the way between them is known to a quarter of a metre.
    """
    way = np.stack([frame.world_from_camera[:2, 3] for frame in context.mapper.keyframes])
    return np.linalg.norm(places(context)[:, None, :2] - way, axis=2).min(axis=1)
