"""NARUTO: go where most uncertainty is within sight, then look at the worst of it."""

from __future__ import annotations

import numpy as np

from activestructure_gym.policies.base import POLICIES, Observation, best_valid, nearest_new, travel_discount
from activestructure_gym.policies.candidates import Candidates
from activestructure_gym.policies.greedy import Planner, Travel
from activestructure_gym.policies.native_settings import NativeSettings

AT_GOAL = 0.75  # metres: the candidates around a lattice position, since few directions of one are on offer at a time
FACING = float(np.cos(np.radians(25.0)))  # a target this near to the axis is in the image: it is 60 degrees high


@POLICIES.register("naruto")
class Naruto(Planner):
    """g* = argmax S(g), S(g) = sum of sigma(t) over the targets t seen from g ([naruto]); no travel cost.

    sigma is the mean squared error of the rendered depth at t, and 3.06 where nobody looked; the 300 targets are a
    part of the 4000 most uncertain places in front of surfaces; seen are those 0.5 to 2 m away along 30 free samples
    (feature ``naruto``). Two stages:

    - goal: among the candidates at g*, one that looks at the most uncertain target;
    - look: at g*, all of the look-at list (feature ``naruto_look``: up to 10 targets, from the most uncertain on), each
      time the candidate with the smallest rotation that looks at a target not yet looked at.

    Source: [naruto, code].
    """

    criterion = "uncertain places within 0.5 to 2 m, then a list of them to look at"
    source = "Feng et al., NARUTO, CVPR 2024"
    required_features = ("naruto", "naruto_look")
    native_settings = NativeSettings(
        stages=(("targets?rows=128", "turns?count=8"),),
        candidates=136,
        budget="2000 frames (Replica), 5000 (MP3D); 10 iterations every 5 frames",
    )

    def __init__(self, travel: Travel = "native") -> None:
        super().__init__(travel)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Begin without a goal."""
        super().reset(seed)
        self._goal = np.zeros(3)
        self._left = np.zeros((0, 3))  # of the look-at list

    def act(self, observation: Observation) -> int:
        """The next look at the goal, or the next goal where the list is done or the goal was not reached."""
        candidates = self.candidates(observation)
        here = observation["pose"][:3]
        if np.linalg.norm(here - self._goal) > AT_GOAL:
            self._left = self._left[:0]
        stage, choice = "look", self._next_look(observation, candidates)
        if choice is None:
            stage, choice = "goal", self._next_goal(observation, candidates)
        looked = looked_at(candidates, self._left)[choice]
        self._left = self._left[~looked]
        self._trace = {
            "stage": stage,
            "naruto": float(candidates["naruto"][choice]),
            "looked_at": int(looked.sum()),
            "left": len(self._left),
        }
        return choice

    def _next_look(self, observation: Observation, candidates: Candidates) -> int | None:
        """The candidate at the goal with the smallest rotation of those that look at something left on the list."""
        count = looked_at(candidates, self._left).sum(axis=1)
        rows = candidates.valid & self._around(candidates) & (count > 0)
        if not rows.any():
            return None
        if self.travel == "shared":
            return best_valid(np.where(rows, count * travel_discount(observation), -1.0), observation)
        turn = candidates.view_direction @ forward(observation["pose"][3:])
        return best_valid(np.where(rows, turn, -2.0), observation)

    def _next_goal(self, observation: Observation, candidates: Candidates) -> int:
        """The best goal's candidate that looks at the first target of its list, else at any, else as it comes."""
        gain = np.where(candidates.revisit, 0.0, candidates["naruto"])
        if not gain[candidates.valid].any():  # no target in reach of anything
            self._left = self._left[:0]
            return nearest_new(observation)
        best = best_valid(self.scores(gain, observation), observation)
        self._goal = candidates.xyz[best].astype(np.float64)
        listed = candidates.feature("naruto_look")[best].reshape(-1, 3)
        self._left = listed[np.linalg.norm(listed - self._goal, axis=1) > 0.1].astype(np.float64)
        looks = looked_at(candidates, self._left)
        around = candidates.valid & self._around(candidates)
        offset = np.linalg.norm(candidates.xyz - self._goal, axis=1)
        for good in (looks[:, :1].any(axis=1), looks.any(axis=1)):
            if (around & good).any():
                return best_valid(np.where(around & good, -offset, -np.inf), observation)
        return best

    def _around(self, candidates: Candidates) -> np.ndarray:  # [K] bool
        near = np.linalg.norm(candidates.xyz - self._goal, axis=1) <= AT_GOAL
        return near & ~candidates.revisit


def looked_at(candidates: Candidates, targets: np.ndarray) -> np.ndarray:  # [T, 3] metres -> [K, T] bool
    """Which targets each candidate faces; what stands in between is not asked, so near the goal only."""
    offset = targets - candidates.xyz[:, None]
    along = (offset * candidates.view_direction[:, None]).sum(axis=2)
    return along >= FACING * np.maximum(np.linalg.norm(offset, axis=2), 1e-9)


def forward(quaternion: np.ndarray) -> np.ndarray:  # [4] wxyz -> [3]
    """Viewing direction of a camera of this orientation: its z axis."""
    w, x, y, z = quaternion.astype(np.float64)
    return np.array([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)])
