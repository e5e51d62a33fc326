"""Greedy in one gain: the common shape of every planner that scores views one by one."""

from __future__ import annotations

from typing import Any

import numpy as np

from activestructure_gym.policies.base import Observation, Policy, best_valid, travel_discount


class Greedy(Policy):
    """T* = argmax softmax(log IG) g = argmax IG g (Eq. 15) with the first of the required gains as IG.

    softmax(log IG) is IG / sum IG, and the sum is the same for every candidate. The gain must not be negative.
    """

    def __init__(self) -> None:
        super().__init__()
        self._trace: dict[str, Any] = {}

    def act(self, observation: Observation) -> int:
        """The valid row with the largest product of gain and travel discount."""
        name = self.required_gains[0]
        gain, travel = self.gain(observation, name), travel_discount(observation)
        # Where nothing is left to gain the product is 0 throughout; the floor then leaves the choice to the distance.
        choice = best_valid(np.maximum(gain, 1e-6) * travel, observation)
        self._trace = {name: float(gain[choice]), "travel": float(travel[choice])}
        return choice

    def trace(self) -> dict[str, Any]:
        """The two factors of the chosen view."""
        return self._trace
