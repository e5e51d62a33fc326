"""The unknown space that the way to a view opens, as the only score: exploration without map or planes."""

from __future__ import annotations

from activestructure_gym.policies.base import POLICIES
from activestructure_gym.policies.greedy import SharedGreedy


@POLICIES.register("unknown_volume")
class UnknownVolume(SharedGreedy):
    """score = V / (1 + frames / 5), V the unknown space opened on the way: phase I of `activestructure`, no planes."""

    criterion = "unknown space opened on the way"
    source = "this project, after [bircher2016] and [delmerico2018]"
    required_features = ("unknown_volume_way",)
