"""Compute ANM (ActiveINR)'s feature: the cluster of uncertain surface assigned to each candidate, and its target."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.in_horizon import returns
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.uncertain_surface import Surface, by_perturbing_all, by_proxy, clusters
from activestructure_gym.volume import FREE, OCCUPIED, VoxelVolume

KEPT = 0.8  # share of the surface that is clustered, the most uncertain part
CEILING = 0.8  # metres below the top of the workspace; higher surface is left out, since a ceiling connects all walls
MIN_TARGET_DISTANCE_M = 1.0  # metres from the agent; nearer targets are only used if all are nearer
ONE_HEIGHT_M = 1e-3  # metres; candidates whose heights differ by less belong to a robot on wheels
# Metres above the bottom of the workspace: from a target of a robot on wheels down to this height, nothing may be
# occupied ([activeinr, code], whose camera is at 1.25 m).
FOOT_M = 0.4
_SAMPLES = 10  # number of tested points over this range


def assigned(context: FeatureContext, uncertainty: Callable[[FeatureContext], Surface]) -> np.ndarray:  # [K, 4]
    """Compute the surface share of the cluster assigned to each candidate, and the cluster's target (metres, world).

    ``uncertainty`` returns the surface with its uncertainty. The target is the camera position for the cluster
    (`Clusters.targets`); if all candidates have one height, it has that height too. Targets should be free (`free`), at
    least 1 m from the agent, and inside the bounding box of the depth returns of the newest keyframe. A condition that
    no remaining target satisfies is skipped (`preferred`).

    Each cluster, the largest first, is assigned the candidate that is nearest to its target and to its view direction
    -mean n. One metre counts as much as a right angle. Revisits and candidates of larger clusters are left out.
    Candidates without a cluster have 0 and their own position. Source: [anm], [activeinr, code].
    """
    poses, newest = context.world_from_camera, context.mapper.keyframes[-1]
    table = np.concatenate([np.zeros((len(poses), 1)), poses[:, :3, 3]], axis=1)
    found = clusters(context.once(uncertainty).below(context.bounds[1, 2] - CEILING), KEPT)
    taken = context.revisits.copy()
    heights = poses[~taken, 2, 3]
    on_wheels = len(heights) > 0 and float(np.ptp(heights)) < ONE_HEIGHT_M
    targets, seen = found.targets.copy(), returns(newest)
    if on_wheels:
        targets[:, 2] = heights[0]
    low, high = (seen.min(axis=0), seen.max(axis=0)) if len(seen) else (np.zeros(3), np.zeros(3))
    inside = np.all((targets > low) & (targets < high), axis=1)
    for cluster in np.flatnonzero(
        preferred(
            free(context.volume, targets, context.bounds[0, 2] + FOOT_M if on_wheels else None),
            np.linalg.norm(targets - newest.world_from_camera[:3, 3], axis=1) > MIN_TARGET_DISTANCE_M,
            inside,
        )
    ):  # clusters are sorted, the largest first
        if taken.all():
            break
        target, direction = targets[cluster], found.directions[cluster]
        cost = np.linalg.norm(poses[:, :3, 3] - target, axis=1) + 1.0 - poses[:, :3, 2] @ direction
        row = int(np.where(taken, np.inf, cost).argmin())
        taken[row], table[row, 0], table[row, 1:] = True, found.shares[cluster], target
    return table


def free(volume: VoxelVolume, targets: np.ndarray, foot: float | None) -> np.ndarray:  # [C, 3] metres -> [C] bool
    """Return which targets are free: the agent's body there is not occupied, or without wheels, the voxel is free.

    The body reaches from the target down to the height ``foot`` (metres, world); None without wheels. Its voxels may be
    unknown, as in the original, which tests the sign of the signed distance.
    """
    if foot is None:
        return volume.state_at(targets) == FREE
    body = np.repeat(targets[:, None], _SAMPLES, axis=1)
    body[:, :, 2] = np.linspace(targets[:, 2], np.minimum(foot, targets[:, 2]), _SAMPLES, axis=1)
    return (volume.state_at(body.reshape(-1, 3)).reshape(-1, _SAMPLES) != OCCUPIED).all(axis=1)


def preferred(*conditions: np.ndarray) -> np.ndarray:  # [C] bool each -> [C] bool
    """Return which of C entries satisfy the conditions, applied one after the other.

    A condition that no remaining entry satisfies is skipped.
    """
    keep = np.ones(len(conditions[0]), dtype=bool)
    for condition in conditions:
        if (keep & condition).any():
            keep &= condition
    return keep


_COLUMNS: dict[str, Any] = {
    "columns": ("", "x", "y", "z"),
    "unit": ("share of the uncertain surface", "m", "m", "m"),
    "low": (0.0, -np.inf, -np.inf, -np.inf),
    "high": (1.0, np.inf, np.inf, np.inf),
}


@FEATURES.register("activeinr", **_COLUMNS)
def activeinr(context: FeatureContext) -> np.ndarray:  # [K, 4]
    """Compute the share of the surface in the candidate's uncertain cluster, and the cluster's target (m, world).

    A cluster is a connected part of the most uncertain 80 % of the surface. Each cluster is assigned one candidate near
    its target. Most candidates have no cluster: their share is 0, and their target is their own position. The
    uncertainty comes from 20 renderings of the map with perturbed parameters. Source: [anm], [activeinr, code].
    """
    return assigned(context, by_perturbing_all)


@FEATURES.register("activeinr_proxy", **_COLUMNS)
def activeinr_proxy(context: FeatureContext) -> np.ndarray:  # [K, 4]
    """Compute the share of the surface in the candidate's uncertain cluster, and the cluster's target (m, world).

    The columns are those of ``activeinr``. The uncertainty is a first-order approximation that needs no rendering.
    """
    return assigned(context, by_proxy)
