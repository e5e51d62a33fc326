"""The unknown surface behind a view's holes as the only score: rung E's first term, without any plane."""

from __future__ import annotations

from activestructure_gym.policies.base import POLICIES
from activestructure_gym.policies.greedy import SharedGreedy


@POLICIES.register("hole_area")
class HoleArea(SharedGreedy):
    """The first term of rung E alone: no Plane Scene Graph, no phases."""

    decides_by = "unseen area behind holes of the map"
    source = "this project: the first term of activestructure alone"
    required_gains = ("hole_area",)
