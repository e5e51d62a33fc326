"""ANM (ActiveINR)'s feature: which uncertain cluster each view stands for, and that cluster's target."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.uncertain_surface import Surface, by_perturbing_all, by_proxy, clusters
from activestructure_gym.volume import FREE

KEPT = 0.8  # of the surface, the most uncertain
CEILING = 0.8  # metres from the top of the workspace: what is higher is left out, as it joins all walls to one piece
MIN_TARGET_DISTANCE_M = 1.0  # metres from the agent: a target nearer than this is none


def assigned(context: FeatureContext, uncertainty: Callable[[FeatureContext], Surface]) -> np.ndarray:  # [K, 4]
    """Per candidate its cluster's share of the surface below the ceiling, and that cluster's target (metres, world).

    Only clusters whose target is free, not too near to the agent and inside the workspace count, each as far as any
    is left (`preferred`). A cluster stands with the candidate nearest to the target that looks along -mean n: a metre
    counts as much as a right angle. Of those without a larger cluster, that is, and no revisit. Candidates without a
    cluster have 0 and their own position. ANM ([anm]).
    """
    poses, here = context.world_from_camera, context.mapper.keyframes[-1].world_from_camera[:3, 3]
    table = np.concatenate([np.zeros((len(poses), 1)), poses[:, :3, 3]], axis=1)
    found = clusters(context.once(uncertainty).below(context.bounds[1, 2] - CEILING), KEPT)
    taken = context.revisits.copy()
    for cluster in np.flatnonzero(
        preferred(
            context.volume.state_at(found.targets) == FREE,
            np.linalg.norm(found.targets - here, axis=1) > MIN_TARGET_DISTANCE_M,
            ((found.targets >= context.bounds[0]) & (found.targets <= context.bounds[1])).all(axis=1),
        )
    ):  # the largest first
        if taken.all():
            break
        target, direction = found.targets[cluster], found.directions[cluster]
        cost = np.linalg.norm(poses[:, :3, 3] - target, axis=1) + 1.0 - poses[:, :3, 2] @ direction
        row = int(np.where(taken, np.inf, cost).argmin())
        taken[row], table[row, 0], table[row, 1:] = True, found.shares[cluster], target
    return table


def preferred(*wishes: np.ndarray) -> np.ndarray:  # [C] bool each -> [C] bool
    """Which entries satisfy the conditions in turn; a condition that no remaining entry satisfies is skipped."""
    keep = np.ones(len(wishes[0]), dtype=bool)
    for wish in wishes:
        if (keep & wish).any():
            keep &= wish
    return keep


_COLUMNS: dict[str, Any] = {
    "columns": ("", "x", "y", "z"),
    "unit": ("share of the uncertain surface", "m", "m", "m"),
    "low": (0.0, -np.inf, -np.inf, -np.inf),
    "high": (1.0, np.inf, np.inf, np.inf),
}


@FEATURES.register("activeinr", **_COLUMNS)
def activeinr(context: FeatureContext) -> np.ndarray:  # [K, 4]
    """`assigned` with the uncertainty of ANM: 20 perturbed renderings."""
    return assigned(context, by_perturbing_all)


@FEATURES.register("activeinr_proxy", **_COLUMNS)
def activeinr_proxy(context: FeatureContext) -> np.ndarray:  # [K, 4]
    """`assigned` with the first order of that uncertainty, which needs no rendering."""
    return assigned(context, by_proxy)
