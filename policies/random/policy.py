"""Define a policy that chooses at random, the lower reference of comparisons."""

from __future__ import annotations

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.policies.base import POLICIES, Observation, Policy
from activestructure_gym.specs import Spec


@POLICIES.register("random")
class Random(Policy):
    """Choose each of the n valid views with probability P = 1 / n.

    Parameters
    ----------
    views_of
        Name of a planner, registered or ``package.module:Class``. In the native setup, chance then has the native
        settings of this planner: its candidate views, camera, keyframes and mapper. So it is the floor of this planner.
    """

    criterion = "chance"
    source = "this project"

    def __init__(self, views_of: str | None = None) -> None:
        """Take over the native settings of ``views_of``; raise `InputError` if no planner has this name."""
        super().__init__()
        if views_of is not None:
            self.native_settings = POLICIES.get(Spec(views_of).name).native_settings

    def act(self, observation: Observation) -> int:
        """Return a valid view, all equally likely; if there is none, a valid row. Raise `InputError` if none is."""
        valid = np.flatnonzero(self.only_views(observation)["action_mask"])
        if not len(valid):
            raise InputError("no candidate is valid: the episode has ended, call reset()")
        return int(self.rng.choice(valid))
