"""Define base classes of planners that score each view by a gain and an exchangeable travel term."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, Literal, get_args

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.policies.base import Observation, Policy, best_valid, travel_discount
from activestructure_gym.policies.scored import FACTOR

Travel = Literal["native", "shared"]


class Planner(Policy):
    """Score views by a gain with the planner's own travel term or with the shared one.

    Parameters
    ----------
    travel
        ``"native"`` scores a view as the planner's paper does (`native_scores`). ``"shared"`` scores it by its gain
        times `travel_discount`, so that planners differ only in the gain.
    """

    min_gain: ClassVar[float] = 0.0  # lower bound of a gain, in the gain's unit

    def __init__(self, travel: Travel = "native") -> None:
        """Store the travel term; raise `InputError` if it is neither "native" nor "shared"."""
        super().__init__()
        if travel not in get_args(Travel):
            raise InputError(f"option travel must be {' or '.join(get_args(Travel))}, got '{travel}'")
        self.travel = travel
        self._trace: dict[str, Any] = {}

    def native_travel(self, observation: Observation) -> np.ndarray:  # [K]
        """Return the planner's own travel factor of each candidate; 1 for a planner without a travel term."""
        return np.ones(len(observation["action_mask"]))

    def native_scores(self, gain: np.ndarray, observation: Observation) -> np.ndarray:  # [K] -> [K]
        """Return the scores with the planner's own travel term, gain times `native_travel`.

        Override this method if the travel term is not a factor on the gain.
        """
        return gain * self.native_travel(observation)

    def score_terms(self, name: str, gain: np.ndarray, observation: Observation) -> dict[str, np.ndarray]:  # [K] each
        """Return the terms of the scores that explain a choice (`best_valid`): the gain ``name`` and the travel factor.

        Override this method together with `native_scores`.
        """
        return {name: gain, f"{FACTOR}travel": self.travel_factor(observation)}

    def travel_factor(self, observation: Observation) -> np.ndarray:  # [K]
        """Return the travel factor of each candidate: the shared one or the planner's own, by the option ``travel``."""
        return travel_discount(observation) if self.travel == "shared" else self.native_travel(observation)

    def scores(self, gain: np.ndarray, observation: Observation) -> np.ndarray:  # [K] >= 0 -> [K]
        """Return the score of every candidate from its gain and the travel term that the option ``travel`` selects.

        If no valid view has a gain above 0, all gains count as 1.
        """
        gain = np.maximum(gain, self.min_gain)
        if not gain[observation["action_mask"].astype(bool)].any():
            gain = np.ones_like(gain)
        if self.travel == "shared":
            return gain * travel_discount(observation)
        return self.native_scores(gain, observation)

    def trace(self) -> dict[str, Any]:
        """Return the gain, the travel factor and other numbers of the last choice."""
        return self._trace


class Greedy(Planner):
    """Choose T* = argmax of the score, where the gain is the first required feature; it must not be negative."""

    # Chooses by the scores: the first of equal ones by `best_valid`, the nearest by `nearest_of_best`.
    choose: ClassVar[Callable[..., int]] = staticmethod(best_valid)

    def act(self, observation: Observation) -> int:
        """Return the valid row with the highest score; `choose` decides between equal ones."""
        if not self.required_features:
            raise InputError(f"{type(self).__name__} needs required_features: the first one is its gain")
        observation = self.only_views(observation)
        name = self.required_features[0]
        gain = self.candidates(observation)[name]
        terms = self.score_terms(name, gain, observation)
        choice = self.choose(self.scores(gain, observation), observation, terms=terms)
        self._trace = {name: float(gain[choice]), "travel": float(self.travel_factor(observation)[choice])}
        return choice


class SharedGreedy(Greedy):
    """Choose T* = argmax softmax(log IG) g (Eq. 15), with the shared travel term g (`travel_discount`).

    This equals argmax IG g: softmax(log IG) is IG / sum IG, and the sum is the same for every candidate.
    """

    travel_term = "the shared one"
    min_gain = 1e-6  # lower bound of a gain, less than one pixel's share of the image

    def __init__(self) -> None:
        super().__init__("shared")
