"""Define variant A of the paper's ablation (Table 3): score views by uncovered pixels."""

from __future__ import annotations

from activestructure_gym.policies.base import POLICIES
from activestructure_gym.policies.greedy import SharedGreedy


@POLICIES.register("pixel_only")
class PixelOnly(SharedGreedy):
    """Choose argmax IG_px / (1 + frames / 5): Eq. 15 with omega = 0 and rho = 0.

    IG_px is the share of uncovered pixels in the candidate's view, ``frames`` the length of the path to it in frames.
    """

    criterion = "uncovered pixels, with the shared travel factor"
    source = "ActiveStructure, Eq. 15 with omega = rho = 0"
    required_features = ("pixel",)
