"""Whether a view's place lies within what the newest keyframe on the way has seen."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.voronoi_node import places, voronoi_node
from activestructure_gym.sensors import Frame

_MOVED = 0.05  # metres in the plane: half a step
_CLEAR = 1e-3  # metres of clearance: every voxel on the way is free


@FEATURES.register("in_horizon", unit="0 or 1", low=0.0, high=1.0)
def in_horizon(context: FeatureContext) -> np.ndarray:  # [K] 0 or 1
    """1 where the straight way to the view's Voronoi node (or itself) is free and ends inside the last box.

    The box holds, in the plane, the camera and all returns of `last_on_the_way`. Where no node with a free way lies in
    it, every free way counts. ActiveSplat's and ANM-S's rule: [activesplat, code], [anm_s, code].
    """
    frame, ends = last_on_the_way(context.mapper.keyframes), places(context)
    here, camera = context.mapper.keyframes[-1].world_from_camera[:3, 3], frame.world_from_camera
    seen = frame.camera.backproject(frame.depth)[frame.depth > 0] @ camera[:3, :3].T + camera[:3, 3]
    box = np.vstack([seen, camera[:3, 3]])[:, :2]
    inside = ((ends[:, :2] >= box.min(axis=0)) & (ends[:, :2] <= box.max(axis=0))).all(axis=1)
    sight = context.volume.segments_free(here, ends, min_clearance=_CLEAR)
    at_node = context.once(voronoi_node) >= 0
    return (sight & inside if (sight & inside & at_node).any() else sight).astype(np.float64)


def last_on_the_way(keyframes: list[Frame]) -> Frame:
    """The newest keyframe that was taken somewhere else than the one before; the newest of all where there is none.

    So what is in the box does not hang on where the agent happens to look at a stop.
    """
    at = np.array([frame.world_from_camera[:2, 3] for frame in keyframes])
    moved = np.flatnonzero(np.linalg.norm(np.diff(at, axis=0), axis=1) > _MOVED)
    return keyframes[int(moved[-1]) + 1 if len(moved) else -1]
