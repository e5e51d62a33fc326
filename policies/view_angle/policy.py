"""Define COVER ([cover]): choose the view whose directions differ most from the directions seen so far."""

from __future__ import annotations

from dataclasses import replace

from activestructure_gym.policies.base import POLICIES, Observation, nearest_of_best
from activestructure_gym.policies.greedy import Planner
from activestructure_gym.policies.native_settings import SELECTED_VIEWS


@POLICIES.register("view_angle")
class ViewAngle(Planner):
    """Choose argmin of the mean coverage of a view's directions, without a travel term.

    A direction is covered if a keyframe saw the surface from a near direction (feature `view_angle`). Of equal views,
    the nearest is chosen.
    """

    criterion = "directions from which the map was not seen"
    travel_term = "none; ties by path length"
    source = "COVER, arXiv 2604.05259"
    required_features = ("view_angle",)
    native_settings = replace(SELECTED_VIEWS, iterations=200, budget="10 random views, then one every 200 steps")

    def act(self, observation: Observation) -> int:
        """Return the valid row with the highest score; of equal ones the one with the fewest frames."""
        gain = self.candidates(observation)["view_angle"]
        terms = self.score_terms("view_angle", gain, observation)
        choice = nearest_of_best(self.scores(gain, observation), observation, terms=terms)
        self._trace = {"view_angle": float(gain[choice]), "travel": float(self.travel_factor(observation)[choice])}
        return choice
