"""GAVIS as a policy ([gavis])."""

from __future__ import annotations

from dataclasses import replace

from activestructure_gym.policies.base import POLICIES, Observation, nearest_of_best
from activestructure_gym.policies.greedy import Planner
from activestructure_gym.policies.native_settings import SELECTED_VIEWS


@POLICIES.register("gavis")
class Gavis(Planner):
    """argmax of the entropy of a view's colours, of which only what was seen from its side is known; no travel term."""

    criterion = "entropy of what a view shows, known only where it was seen from that side"
    travel_term = "none; ties by path length"
    source = "by a digest of Xue et al., GAVIS, CVPR 2026"
    required_features = ("gavis",)
    native_settings = replace(SELECTED_VIEWS, budget="")

    def act(self, observation: Observation) -> int:
        """The valid row with the highest score; of equals the one with the fewest frames."""
        gain = self.candidates(observation)["gavis"]
        choice = nearest_of_best(self.scores(gain, observation), observation)
        self._trace = {"gavis": float(gain[choice]), "travel": float(self.travel_factor(observation)[choice])}
        return choice
