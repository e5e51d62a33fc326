"""All that is not seen yet, behind the known space and behind the known surfaces, as the only score."""

from __future__ import annotations

import numpy as np

from activestructure_gym.policies.base import POLICIES, Observation, best_valid
from activestructure_gym.policies.greedy import SharedGreedy

SIDE_DEPTH = 0.35  # metres: unknown space that an unseen side counts as deep


@POLICIES.register("unseen")
class Unseen(SharedGreedy):
    """score = (V + .35 m A) / (1 + frames / 5), V the unknown space opened on the way, A the area seen from behind.

    While rooms open V is by far the larger, so it goes as `unknown_volume` does; where all has been looked into, A is
    what the map tells of the far sides of things.
    """

    criterion = "unknown space opened on the way and unseen sides"
    source = "this project"
    required_features = ("unknown_volume_way", "unseen_sides")

    def act(self, observation: Observation) -> int:
        """The valid row with the highest score; the first of equals."""
        candidates = self.candidates(observation)
        space = candidates["unknown_volume_way"].astype(np.float64)
        sides = SIDE_DEPTH * candidates["unseen_sides"].astype(np.float64)
        choice = best_valid(self.scores(space + sides, observation), observation)
        travel = float(self.travel_factor(observation)[choice])
        self._trace = {"space": float(space[choice]), "sides": float(sides[choice]), "travel": travel}
        return choice
