"""Base classes of planners that score views one by one: a gain and an exchangeable travel term."""

from __future__ import annotations

from typing import Any, ClassVar, Literal, get_args

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.policies.base import Observation, Policy, best_valid, travel_discount

Travel = Literal["native", "shared"]


class Planner(Policy):
    """A planner with its own travel term, which can be run with everybody's instead.

    Parameters
    ----------
    travel
        ``"native"`` scores a view as the planner's paper does, by `native`; ``"shared"`` by its gain times
        `travel_discount` and nothing else, so that planners differ in what they hold a view to be worth alone.
    """

    min_gain: ClassVar[float] = 0.0  # a gain below counts as this much, in the gain's unit

    def __init__(self, travel: Travel = "native") -> None:
        super().__init__()
        if travel not in get_args(Travel):
            raise InputError(f"option travel must be {' or '.join(get_args(Travel))}, got '{travel}'")
        self.travel = travel
        self._trace: dict[str, Any] = {}

    def native_travel(self, observation: Observation) -> np.ndarray:  # [K]
        """The planner's own factor on the gain; 1 for a planner without a travel term."""
        return np.ones(len(observation["action_mask"]))

    def native_scores(self, gain: np.ndarray, observation: Observation) -> np.ndarray:  # [K] -> [K]
        """The planner's own score; to be replaced where its travel term is no factor."""
        return gain * self.native_travel(observation)

    def travel_factor(self, observation: Observation) -> np.ndarray:  # [K]
        """The factor in use."""
        return travel_discount(observation) if self.travel == "shared" else self.native_travel(observation)

    def scores(self, gain: np.ndarray, observation: Observation) -> np.ndarray:  # [K] >= 0 -> [K]
        """Scores of the views: gain and travel term, or the travel term alone where no valid view has a gain."""
        gain = np.maximum(gain, self.min_gain)
        if not gain[observation["action_mask"].astype(bool)].any():
            gain = np.ones_like(gain)
        if self.travel == "shared":
            return gain * travel_discount(observation)
        return self.native_scores(gain, observation)

    def trace(self) -> dict[str, Any]:
        """Numbers that a planner noted about the chosen view."""
        return self._trace


class Greedy(Planner):
    """T* = argmax of the score of one gain, the first of the required ones, which must not be negative."""

    def act(self, observation: Observation) -> int:
        """The valid row with the highest score; the first of equals."""
        name = self.required_features[0]
        gain = self.candidates(observation)[name]
        choice = best_valid(self.scores(gain, observation), observation)
        self._trace = {name: float(gain[choice]), "travel": float(self.travel_factor(observation)[choice])}
        return choice


class SharedGreedy(Greedy):
    """Greedy whose own travel term is the shared one: T* = argmax softmax(log IG) g = argmax IG g (Eq. 15).

    softmax(log IG) is IG / sum IG, and the sum is the same for every candidate.
    """

    travel_term = "the shared one"
    min_gain = 1e-6  # of gains that are shares of an image: below the share of any pixel

    def __init__(self) -> None:
        super().__init__("shared")
