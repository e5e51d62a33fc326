"""Define a policy that explores unknown space and unseen sides of known surfaces."""

from __future__ import annotations

import numpy as np

from activestructure_gym.policies.base import POLICIES, Observation, best_valid
from activestructure_gym.policies.greedy import SharedGreedy

SIDE_DEPTH = 0.35  # metres; an area of unseen side counts as unknown space of this depth


@POLICIES.register("unseen")
class Unseen(SharedGreedy):
    """Choose argmax (V + 0.35 m A) / (1 + frames / 5).

    V is the unknown volume in m^3 that the path to a view would reveal. A is the visible area in m^2 of surfaces of
    which only the other side is mapped. V is much larger during exploration, so the policy then acts like
    `unknown_volume`. A decides once all space has been seen.
    """

    criterion = "unknown space revealed along the path, and unseen sides"
    source = "this project"
    required_features = ("unknown_volume_way", "unseen_sides")

    def act(self, observation: Observation) -> int:
        """Return the valid row with the highest score; the first of equal ones."""
        candidates = self.candidates(observation)
        space = candidates["unknown_volume_way"].astype(np.float64)
        sides = SIDE_DEPTH * candidates["unseen_sides"].astype(np.float64)
        choice = best_valid(self.scores(space + sides, observation), observation)
        travel = float(self.travel_factor(observation)[choice])
        self._trace = {"space": float(space[choice]), "sides": float(sides[choice]), "travel": travel}
        return choice
