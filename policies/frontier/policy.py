"""Define ActiveGS's frontier planner: score visible unexplored space, minus path length."""

from __future__ import annotations

from activestructure_gym.policies.active_gs.policy import ActiveGS
from activestructure_gym.policies.base import POLICIES
from activestructure_gym.policies.native_settings import NativeSettings


@POLICIES.register("frontier")
class Frontier(ActiveGS):
    """Choose argmax of V / sum V - 0.5 L / sum L; V is the number of visible unexplored voxels, L the path length."""

    criterion = "visible unexplored voxels"
    source = "Jin et al., ActiveGS, RA-L 2025: its exploration alone"
    required_features = ("unexplored",)
    native_settings = NativeSettings(
        stages=(("frontier_facing?rows=30", "around?rows=70"),),
        candidates=100,
        goal_keyframes=True,
        budget=ActiveGS.native_settings.budget,
    )
