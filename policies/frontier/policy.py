"""Define ActiveGS's frontier planner: score visible unexplored space, minus path length."""

from __future__ import annotations

from dataclasses import replace

from activestructure_gym.policies.active_gs.policy import ActiveGS
from activestructure_gym.policies.base import POLICIES


@POLICIES.register("frontier")
class Frontier(ActiveGS):
    """Choose argmax of V / sum V - 0.5 L / sum L; V is the number of visible unexplored voxels, L the path length."""

    criterion = "visible unexplored voxels"
    source = "Jin et al., ActiveGS, RA-L 2025: its exploration alone"
    required_features = ("unexplored",)
    native_settings = replace(ActiveGS.native_settings, stages=(("frontier_facing?rows=30", "around?rows=70"),))
