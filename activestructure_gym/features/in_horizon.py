"""Test whether a view is in a straight line on the floor plan, inside the region that a keyframe observed."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.voronoi_node import floor_plan, places, voronoi_node
from activestructure_gym.sensors import Frame

AGENT_M = 0.1  # metres, radius of the agent; the plan below it does not block a line
_MOVED = 0.05  # metres in the floor plane; a keyframe farther from its predecessor has moved (half a step of the agent)


@FEATURES.register("in_horizon", unit="0 or 1", low=0.0, high=1.0)
def in_horizon(context: FeatureContext) -> np.ndarray:  # [K] 0 or 1
    """Return 1 where the straight line to the view's Voronoi node is free and ends inside the horizon, else 0.

    A view without a node is its own end point. The line is drawn on the `floor_plan`. The horizon is the bounding box,
    in the floor plane, of the camera and all depth returns of the keyframe `departed`. If no node with a free line is
    inside the horizon, all free lines count. This is the rule of ActiveSplat: [activesplat, code].
    """
    frame = departed(context.mapper.keyframes)
    return in_sight_within(context, np.vstack([returns(frame), frame.world_from_camera[:3, 3]]))


def in_sight_within(context: FeatureContext, points: np.ndarray) -> np.ndarray:  # [K] 0 or 1
    """Return 1 where the line to the view's node on the plan is free and ends in the box around ``points``, else 0.

    The box is in the floor plane; ``points`` [n, 3] are metres in the world, n >= 1. If no node with a free line is
    inside the box, all free lines count.
    """
    ends, box = places(context), points[:, :2]
    here = context.mapper.keyframes[-1].world_from_camera[:3, 3]
    inside = ((ends[:, :2] >= box.min(axis=0)) & (ends[:, :2] <= box.max(axis=0))).all(axis=1)
    corner, size = context.volume.origin[:2], context.volume.voxel_size
    start, stops = (here[:2] - corner) / size, (ends[:, :2] - corner) / size
    free = lines_free(context.once(floor_plan), start, stops, AGENT_M / size)
    at_node = context.once(voronoi_node) >= 0
    return (free & inside if (free & inside & at_node).any() else free).astype(np.float64)


def returns(frame: Frame) -> np.ndarray:  # [n, 3] metres, world
    """Return the points of all depth returns of a frame."""
    camera = frame.world_from_camera
    return frame.camera.backproject(frame.depth)[frame.depth > 0] @ camera[:3, :3].T + camera[:3, 3]


def lines_free(
    plan: np.ndarray,  # [X, Y] bool
    start: np.ndarray,  # [2] cells; the corner of cell (0, 0) is at 0
    ends: np.ndarray,  # [K, 2] cells
    spared: float,  # cells from the start that are not tested
) -> np.ndarray:  # [K] bool
    """Return which straight lines have only free cells of the plan, tested at every quarter of a cell."""
    lines, which = np.unique(np.asarray(ends, np.float64), axis=0, return_inverse=True)
    free = np.ones(len(lines), dtype=bool)
    for row, end in enumerate(lines):
        length = float(np.linalg.norm(end - start))
        along = np.linspace(0.0, 1.0, int(np.ceil(4.0 * length)) + 1)
        cells = np.floor(start + along[along * length >= spared, None] * (end - start)).astype(np.int64)
        inside = ((cells >= 0) & (cells < plan.shape)).all(axis=1)
        free[row] = inside.all() and plan[tuple(cells.T)].all()
    return free[which.ravel()]


def departed(keyframes: list[Frame]) -> Frame:
    """Return the keyframe at which the last movement began, or the newest of all if there is none.

    The original renews its box when it decides, and this box holds from the next movement on. So the choice at the end
    of a movement uses what was observed at its beginning.
    """
    moved = _moved(keyframes)
    if not moved.any():
        return keyframes[-1]
    still = np.flatnonzero(~moved[: np.flatnonzero(moved)[-1]])
    return keyframes[int(still[-1]) + 1 if len(still) else 0]


def last_moved(keyframes: list[Frame]) -> Frame:
    """Return the newest keyframe that is more than 5 cm from its predecessor, or the newest of all if there is none.

    The keyframes after it were taken on the spot. A horizon from them would depend on how the camera turned.
    """
    moved = np.flatnonzero(_moved(keyframes))
    return keyframes[int(moved[-1]) + 1 if len(moved) else -1]


def _moved(keyframes: list[Frame]) -> np.ndarray:  # [N - 1] bool
    """Return whether each keyframe but the first is more than 5 cm from its predecessor, in the floor plane."""
    at = np.array([frame.world_from_camera[:2, 3] for frame in keyframes])
    return np.asarray(np.linalg.norm(np.diff(at, axis=0), axis=1) > _MOVED)
