"""COVER (arXiv 2604.05259): the view from the newest side."""

from __future__ import annotations

from activestructure_gym.policies.base import POLICIES
from activestructure_gym.policies.greedy import Greedy


@POLICIES.register("view_angle")
class ViewAngle(Greedy):
    """argmin of the mean coverage of the viewing directions; no travel term (peers_info_rl.md A6)."""

    required_gains = ("view_angle",)
