"""Define COVER ([cover]): choose the view whose directions differ most from the directions seen so far."""

from __future__ import annotations

from dataclasses import replace

from activestructure_gym.policies.base import POLICIES, nearest_of_best
from activestructure_gym.policies.greedy import Greedy
from activestructure_gym.policies.native_settings import SELECTED_VIEWS


@POLICIES.register("view_angle")
class ViewAngle(Greedy):
    """Choose argmin of the mean coverage of a view's directions, without a travel term.

    A direction is covered if a keyframe saw the surface from a near direction (feature `view_angle`). Of equal views,
    the nearest is chosen.
    """

    criterion = "directions from which the map was not seen"
    travel_term = "none; ties by path length"
    source = "COVER, arXiv 2604.05259"
    required_features = ("view_angle",)
    native_settings = replace(SELECTED_VIEWS, iterations=200, budget="10 random views, then one every 200 steps")
    choose = staticmethod(nearest_of_best)
