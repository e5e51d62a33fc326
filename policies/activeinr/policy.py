"""Define ANM (ActiveINR): move to the largest cluster of uncertain surface, at any distance."""

from __future__ import annotations

from typing import get_args

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.policies.anm_s.policy import Uncertainty
from activestructure_gym.policies.base import (
    POLICIES,
    Observation,
    at_current_pose,
    best_valid,
    nearest_new,
)
from activestructure_gym.policies.greedy import Planner, Travel
from activestructure_gym.policies.native_settings import SQUARE_CAMERA, NativeSettings

REACHED_M = 0.8  # metres from the target at which the next one is chosen
NEARER_M = 0.01  # metres by which a view must be nearer to the target than the agent, or it would only turn in place
PATIENCE = 100  # frames after which the next target is chosen (steps of 6.5 cm or 10 degrees in [activeinr, code])


@POLICIES.register("activeinr")
class ActiveINR(Planner):
    """Choose target* = mean of v + 0.5 n over the points v of the largest cluster of uncertain surface ([anm]).

    Clusters are connected parts of the most uncertain 80 % of the surface, each at least 0.5 % of it. Targets that are
    free, more than 1 m away and inside the bounding box of what the newest keyframe sees are preferred (feature
    ``activeinr``). There is no travel term. The target is kept until the agent is within 0.8 m, has moved for 100
    frames, or no candidate is nearer to it than the agent. Until then, the candidate nearest to the target is chosen.

    ``uncertainty``: "perturbation" uses 20 perturbed renderings from 12 views. "proxy" is its first-order approximation
    without rendering. Source: [activeinr, code].
    """

    criterion = "the largest piece of uncertain surface"
    source = "Yan et al., Active Neural Mapping, ICCV 2023"
    native_settings = NativeSettings(
        stages=(("floor?yaws=8&rows=504&visited=true", "turns?count=8"),),
        candidates=512,
        changes=SQUARE_CAMERA | {"sensor.max_range": 8.0},
        budget="1000 steps (2000 in large scenes) of 6.5 cm, 256 x 256 at 90 degrees",
    )

    def __init__(self, travel: Travel = "native", uncertainty: Uncertainty = "perturbation") -> None:
        """Store the travel term and the kind of uncertainty; raise `InputError` for an unknown kind."""
        if uncertainty not in get_args(Uncertainty):
            raise InputError(f"option uncertainty must be {' or '.join(get_args(Uncertainty))}, got '{uncertainty}'")
        super().__init__(travel)
        self._feature = "activeinr" if uncertainty == "perturbation" else "activeinr_proxy"
        self.required_features = (self._feature,)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Begin without a target."""
        super().reset(seed)
        self._target: np.ndarray | None = None  # [3] metres
        self._spent = 0.0  # frames of the paths since the target was chosen

    def act(self, observation: Observation) -> int:
        """Return the candidate of the largest cluster, or the candidate nearest to the current target."""
        observation = self.only_views(observation)
        candidates = self.candidates(observation)
        usable = candidates.valid & ~candidates.revisit & ~at_current_pose(candidates)
        share = np.where(usable, candidates[self._feature], 0.0)
        if self._target is not None:
            gap = float(np.linalg.norm(observation["pose"][:3] - self._target))
            gaps = np.where(usable, np.linalg.norm(candidates.xyz - self._target, axis=1), np.inf)
            if gap < REACHED_M or self._spent >= PATIENCE or gaps.min() > gap - NEARER_M:
                self._target = None
        if self._target is None and share.any():
            choice = best_valid(self.scores(share, observation), observation)
            self._target = candidates.feature(self._feature)[choice, 1:].astype(float)
            self._spent, stage = 0.0, "new target"
        elif self._target is not None:
            choice, stage = best_valid(-gaps, observation), "on the way"
        else:  # the map has no surface yet
            choice, stage = nearest_new(observation), "no target"
        self._spent += float(candidates.frames[choice])
        self._trace = {
            "stage": stage,
            self._feature: float(share[choice]),
            "target": None if self._target is None else self._target.round(2).tolist(),
        }
        return choice
