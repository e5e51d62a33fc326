"""Define a baseline that scores views by the unseen area behind holes of the map."""

from __future__ import annotations

from activestructure_gym.policies.base import POLICIES
from activestructure_gym.policies.greedy import SharedGreedy


@POLICIES.register("hole_area")
class HoleArea(SharedGreedy):
    """Choose argmax A / (1 + frames / 5); A is the unseen area behind uncovered pixels (feature `hole_area`)."""

    criterion = "unseen area behind holes of the map"
    source = "this project"
    required_features = ("hole_area",)
