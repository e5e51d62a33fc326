"""Frontier exploration as ActiveGS ships it beside its own planner: unknown space in sight, less the way."""

from __future__ import annotations

from activestructure_gym.policies.active_gs.policy import ActiveGS
from activestructure_gym.policies.base import POLICIES
from activestructure_gym.policies.native_settings import NativeSettings


@POLICIES.register("frontier")
class Frontier(ActiveGS):
    """score = V / sum V - 0.5 L / sum L, V the unknown voxels in sight."""

    criterion = "unexplored voxels in sight"
    source = "Jin et al., ActiveGS, RA-L 2025: its exploration alone"
    required_features = ("unexplored",)
    native_settings = NativeSettings(
        stages=(("frontier_facing?rows=30", "around?rows=70"),),
        candidates=100,
        goal_keyframes=True,
        budget=ActiveGS.native_settings.budget,
    )
