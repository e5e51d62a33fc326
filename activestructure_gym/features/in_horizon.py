"""Test whether a view is inside the region observed by the newest keyframe after a movement."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.voronoi_node import places, voronoi_node
from activestructure_gym.sensors import Frame

_MOVED = 0.05  # metres in the floor plane; a keyframe farther from its predecessor has moved (half a step of the agent)


@FEATURES.register("in_horizon", unit="0 or 1", low=0.0, high=1.0)
def in_horizon(context: FeatureContext) -> np.ndarray:  # [K] 0 or 1
    """Return 1 where the straight path to the view's Voronoi node is free and ends inside the horizon, else 0.

    A view without a node is its own end point. The horizon is the bounding box, in the floor plane, of the camera and
    all depth returns of the keyframe `last_moved`. If no node with a free path is inside the horizon, all free paths
    count. This is the rule of ActiveSplat: [activesplat, code].
    """
    frame = last_moved(context.mapper.keyframes)
    return in_sight_within(context, np.vstack([returns(frame), frame.world_from_camera[:3, 3]]))


def in_sight_within(context: FeatureContext, points: np.ndarray) -> np.ndarray:  # [K] 0 or 1
    """Return 1 where the straight path to the view's node is free and ends in the bounding box of ``points``, else 0.

    The box is in the floor plane; ``points`` [n, 3] are metres in the world, n >= 1. If no node with a free path is
    inside the box, all free paths count.
    """
    ends, box = places(context), points[:, :2]
    here = context.mapper.keyframes[-1].world_from_camera[:3, 3]
    inside = ((ends[:, :2] >= box.min(axis=0)) & (ends[:, :2] <= box.max(axis=0))).all(axis=1)
    free = context.volume.straight_lines_free(here, ends)
    at_node = context.once(voronoi_node) >= 0
    return (free & inside if (free & inside & at_node).any() else free).astype(np.float64)


def returns(frame: Frame) -> np.ndarray:  # [n, 3] metres, world
    """Return the points of all depth returns of a frame."""
    camera = frame.world_from_camera
    return frame.camera.backproject(frame.depth)[frame.depth > 0] @ camera[:3, :3].T + camera[:3, 3]


def last_moved(keyframes: list[Frame]) -> Frame:
    """Return the newest keyframe that is more than 5 cm from its predecessor, or the newest of all if there is none.

    The keyframes after it were taken on the spot. A horizon from them would depend on how the camera turned.
    """
    at = np.array([frame.world_from_camera[:2, 3] for frame in keyframes])
    moved = np.flatnonzero(np.linalg.norm(np.diff(at, axis=0), axis=1) > _MOVED)
    return keyframes[int(moved[-1]) + 1 if len(moved) else -1]
