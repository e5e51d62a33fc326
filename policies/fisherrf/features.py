"""Score views by their Fisher information and that of the path to them (FisherRF); nothing is counted twice."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.fisherrf import KINDS, TIMES, fisherrf
from activestructure_gym.features.information import LAMBDA, diagonal_units, trained
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.mapping.frustum_culling import MapParts
from activestructure_gym.motion import is_level
from activestructure_gym.splatting.fisher import view_information

GOALS = 20  # number of views whose paths are evaluated
HORIZON = 6  # number of keyframes of a path that count: 30 frames with a keyframe every 5
# Weight of log I of the view at the end; the mean of log I over the path has weight 1. The original has the weight 30,
# and divides the sum over every fifth action by the number of actions: 30 x 5.
END_WEIGHT = 150.0
MIN_INFORMATION = 1e-6  # per Gaussian, lower bound of I of a view on the path, so that its logarithm is finite


@FEATURES.register("fisherrf_path", unit="per Gaussian of the map", low=0.0)
def fisherrf_path(context: FeatureContext) -> np.ndarray:  # [K]
    """Compute exp((mean over the path of log I_a + 150 log I_c) / 151) of the 20 views with largest I_c; 0 of others.

    I_c is the feature `fisherrf` of the candidate, per Gaussian of the map. A view a on the path has I_a = sum of
    H_a / (H_path + lambda). H_path is H_train plus the H of all earlier views on the path, so that the same information
    counts once. The views on the path are the first six keyframes that the episode would take, at most up to its end.
    The exponential keeps the unit of I and does not change the order.

    Source: [fisherrf, code] of its active mapping: 20 goals, 30 actions, the weight 30, and H updated along the path.
    The logarithm of I_c is our choice.
    """
    at_end = context.once(fisherrf)
    poses, agent = context.world_from_camera, context.agent
    if agent is None or not is_level(agent.pose) or not len(poses):  # paths exist for poses without roll only
        return at_end
    gain = np.zeros(len(poses))
    first = np.argsort(-at_end, kind="stable")[:GOALS]
    first = first[at_end[first] > 0]
    for row, path in zip(first, agent.paths(context.volume, poses[first])):
        if path is not None and len(path.keyframes):
            along = information_along(context, path.keyframes[:HORIZON])
            gain[row] = np.exp(log_of_path(np.log(np.maximum(along, MIN_INFORMATION)), np.log(at_end[row])))
    return gain


def log_of_path(along: np.ndarray, at_end: float) -> float:  # [V] logarithms of I_a, logarithm of I_c
    """Return the mean of ``along`` with weight 1 and ``at_end`` with weight 150, divided by the sum of the weights."""
    return float((along.mean() + END_WEIGHT * at_end) / (1.0 + END_WEIGHT))


def information_along(context: FeatureContext, world_from_camera: np.ndarray) -> np.ndarray:  # [V, 4, 4] -> [V]
    """Return I_a (see `fisherrf_path`) of V successive views, each given the earlier ones; per Gaussian of the map."""
    gaussians, parts = context.mapper.map, MapParts(context.mapper.map)
    columns, unit = diagonal_units(context, KINDS)
    known = trained(context)[:, columns] / unit + LAMBDA
    sums = np.zeros(len(world_from_camera))
    for a, pose in enumerate(world_from_camera):
        unseen = parts.unseen(context.camera, pose)
        (view,) = view_information(gaussians.parameters, gaussians.count, context.camera, pose, unseen=unseen)
        added = view.numbers[:, columns] / unit
        sums[a] = (added / known[view.indices] * TIMES).sum()
        known[view.indices] += added
    return sums / max(1, gaussians.count)
