"""Frontier exploration as ActiveGS ships it beside its own planner: unknown space in sight, less the way."""

from __future__ import annotations

from activestructure_gym.policies.active_gs import ActiveGS
from activestructure_gym.policies.base import POLICIES


@POLICIES.register("frontier")
class Frontier(ActiveGS):
    """score = V / sum V - 0.5 L / sum L, V the unknown voxels in sight (peers_active.md 3.4 and 5, `exploration`)."""

    required_gains = ("unexplored",)
