"""Whether a place lies within what the last observation showed."""

from __future__ import annotations

import numpy as np

from activestructure_gym.views.gains.base import GAINS, GainContext
from activestructure_gym.views.gains.voronoi_node import places

_CLEAR = 1e-3  # metres of clearance: every voxel on the way is free


@GAINS.register("in_horizon")
def in_horizon(context: GainContext) -> np.ndarray:  # [K] 0 or 1
    """1 where the straight way to the view's Voronoi node (or itself) is free and ends inside the last frame's box.

    The box holds, in the plane, the last keyframe's camera and all its returns. ActiveSplat's and ANM-S's rule
    (`../shared/research/peers_active.md`, 3.1).
    """
    frame, ends = context.mapper.keyframes[-1], places(context)
    here = frame.world_from_camera[:3, 3]
    seen = frame.camera.backproject(frame.depth)[frame.depth > 0] @ frame.world_from_camera[:3, :3].T + here
    box = np.vstack([seen, here])[:, :2]
    inside = ((ends[:, :2] >= box.min(axis=0)) & (ends[:, :2] <= box.max(axis=0))).all(axis=1)
    inside[inside] = context.volume.segments_free(here, ends[inside], min_clearance=_CLEAR)
    return inside.astype(np.float64)
