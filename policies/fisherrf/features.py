"""Closed-loop FisherRF: the information of a view and of the way there, each look counted as known to the next."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.fisherrf import KINDS, TIMES, fisherrf
from activestructure_gym.features.information import LAMBDA, diagonal_units, trained
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.mapping.frustum_culling import MapParts
from activestructure_gym.motion import is_level
from activestructure_gym.splatting.fisher import view_information

GOALS = 20  # views whose ways are looked along
END_WEIGHT = 30.0  # of the end, against the mean over the way
MIN_INFORMATION = 1e-6  # per Gaussian: below it a view on the way tells nothing


@FEATURES.register("fisherrf_path", unit="per Gaussian of the map", low=0.0)
def fisherrf_path(context: FeatureContext) -> np.ndarray:  # [K]
    """exp((mean over the way of log I_a + 30 log I_c) / 31) of the 20 views with the largest I_c; 0 of the others.

    I_c is `fisherrf`. Along the way I_a = sum of H_a / (H_way + lambda), H_way = H_train and all H_a before it, so that
    what a look has told the next does not tell again. The views of the way are the keyframes that the episode would
    take, its end among them. The exponential puts the sum of logarithms back into the unit of I and changes no order.

    Source: [fisherrf, code] of its active mapping: 20 goals, the weight 30, H updated along the way; that the end
    counts by its logarithm as the others do is filled in.
    """
    at_end = context.once(fisherrf)
    poses, agent = context.world_from_camera, context.agent
    if agent is None or not is_level(agent.pose) or not len(poses):  # ways turn by yaw and pitch alone
        return at_end
    found = np.zeros(len(poses))
    first = np.argsort(-at_end, kind="stable")[:GOALS]
    first = first[at_end[first] > 0]
    for row, way in zip(first, agent.paths(context.volume, poses[first])):
        if way is not None and len(way.keyframes):
            on_way = np.log(np.maximum(information_along(context, way.keyframes), MIN_INFORMATION)).mean()
            found[row] = np.exp((on_way + END_WEIGHT * np.log(at_end[row])) / (1.0 + END_WEIGHT))
    return found


def information_along(context: FeatureContext, world_from_camera: np.ndarray) -> np.ndarray:  # [V, 4, 4] -> [V]
    """I_a of views one after the other, each with what the earlier ones told; per Gaussian of the map."""
    gaussians, parts = context.mapper.map, MapParts(context.mapper.map)
    columns, unit = diagonal_units(context, KINDS)
    known = trained(context)[:, columns] / unit + LAMBDA
    sums = np.zeros(len(world_from_camera))
    for a, pose in enumerate(world_from_camera):
        unseen = parts.unseen(context.camera, pose)
        (view,) = view_information(gaussians.parameters, gaussians.count, context.camera, pose, unseen=unseen)
        told = view.numbers[:, columns] / unit
        sums[a] = (told / known[view.indices] * TIMES).sum()
        known[view.indices] += told
    return sums / max(1, gaussians.count)
