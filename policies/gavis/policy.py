"""Define GAVIS ([gavis]): score views by the entropy of their colours, given the sides seen so far."""

from __future__ import annotations

from dataclasses import replace

from activestructure_gym.policies.base import POLICIES, nearest_of_best
from activestructure_gym.policies.greedy import Greedy
from activestructure_gym.policies.native_settings import SELECTED_VIEWS


@POLICIES.register("gavis")
class Gavis(Greedy):
    """Choose argmax of the entropy of a view's colours (feature `gavis`), without a travel term.

    The entropy is large where keyframes have not seen a surface from the side of the view, or not at all.
    """

    criterion = "entropy of the view's colours, known only from sides seen so far"
    travel_term = "none; ties by path length"
    source = "by a digest of Xue et al., GAVIS, CVPR 2026, and the code of NVF, CVPR 2024"
    required_features = ("gavis",)
    native_settings = replace(SELECTED_VIEWS, budget="10 (objects), 40 (Gibson) or 80 (HM3D) views")
    choose = staticmethod(nearest_of_best)
