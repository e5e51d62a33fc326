"""The unknown surface behind a view's holes as the only score."""

from __future__ import annotations

from activestructure_gym.policies.base import POLICIES
from activestructure_gym.policies.greedy import SharedGreedy


@POLICIES.register("hole_area")
class HoleArea(SharedGreedy):
    """score = A / (1 + frames / 5), A the area of the unknown behind what the map leaves uncovered."""

    criterion = "unseen area behind holes of the map"
    source = "this project"
    required_features = ("hole_area",)
