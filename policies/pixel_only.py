"""Variant A of the paper's ablation (Table 3): pixels only."""

from __future__ import annotations

from typing import Any

import numpy as np

from activestructure_gym.policies.base import POLICIES, Observation, Policy, best_valid, travel_discount


@POLICIES.register("pixel_only")
class PixelOnly(Policy):
    """T* = argmax softmax(log IG_px) g = argmax IG_px g (Eq. 15 with omega = 0 and rho = 0).

    softmax(log IG) is IG / sum IG, and the sum is the same for every candidate.
    """

    required_gains = ("pixel",)

    def __init__(self) -> None:
        super().__init__()
        self._trace: dict[str, Any] = {}

    def act(self, observation: Observation) -> int:
        """The valid row with the largest product of uncovered pixels and travel discount."""
        pixel = self.gain(observation, "pixel")
        travel = travel_discount(observation)
        # Where everything is covered the product is 0 throughout; the floor then leaves the choice to the distance.
        choice = best_valid(np.maximum(pixel, 1e-6) * travel, observation)
        self._trace = {"pixel": float(pixel[choice]), "travel": float(travel[choice])}
        return choice

    def trace(self) -> dict[str, Any]:
        """The two factors of the chosen view."""
        return self._trace
