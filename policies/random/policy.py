"""Define a policy that chooses at random, the lower reference of comparisons."""

from __future__ import annotations

import numpy as np

from activestructure_gym.policies.base import POLICIES, Observation, Policy


@POLICIES.register("random")
class Random(Policy):
    """Choose each of the n valid candidates with probability P = 1 / n."""

    criterion = "chance"
    source = "this project"

    def act(self, observation: Observation) -> int:
        """Return a valid row, all equally likely; raise `ValueError` if none is valid."""
        valid = np.flatnonzero(self.candidates(observation).valid)
        if not len(valid):
            raise ValueError("no candidate is valid: the episode has ended, call reset()")
        return int(self.rng.choice(valid))
