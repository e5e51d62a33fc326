"""Define a policy that explores by volume: it scores the unknown space that the path to a view would reveal."""

from __future__ import annotations

from activestructure_gym.policies.base import POLICIES
from activestructure_gym.policies.greedy import SharedGreedy


@POLICIES.register("unknown_volume")
class UnknownVolume(SharedGreedy):
    """Choose argmax V / (1 + frames / 5), where V is the unknown volume in m^3 that the path to a view would reveal.

    The policy equals phase I of `activestructure` without planes.
    """

    criterion = "unknown space revealed along the path"
    source = "this project, after [bircher2016] and [delmerico2018]"
    required_features = ("unknown_volume_way",)
