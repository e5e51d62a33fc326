"""Unknown surface instead of uncovered pixels: how far one comes without any plane."""

from __future__ import annotations

from activestructure_gym.policies.base import POLICIES
from activestructure_gym.policies.greedy import SharedGreedy


@POLICIES.register("hole_area")
class HoleArea(SharedGreedy):
    """The first term of rung E alone: no Plane Scene Graph, no phases (docs/notebook/method.md has the comparison)."""

    required_gains = ("hole_area",)
