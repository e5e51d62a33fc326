"""COVER ([cover]): the view from the newest side."""

from __future__ import annotations

from activestructure_gym.policies.base import POLICIES, Observation, nearest_of_best
from activestructure_gym.policies.greedy import Planner


@POLICIES.register("view_angle")
class ViewAngle(Planner):
    """argmin of the mean coverage of the viewing directions; no travel term but for equals.

    At first many views show nothing that is mapped and are worth exactly 1: the nearest of these is taken.
    """

    criterion = "directions from which the map was not seen"
    travel_term = "none; ties by path length"
    source = "COVER, arXiv 2604.05259"
    required_features = ("view_angle",)

    def act(self, observation: Observation) -> int:
        """The valid row with the highest score; of equals the one with the fewest frames."""
        gain = self.candidates(observation)["view_angle"]
        choice = nearest_of_best(self.scores(gain, observation), observation)
        self._trace = {"view_angle": float(gain[choice]), "travel": float(self.travel_factor(observation)[choice])}
        return choice
