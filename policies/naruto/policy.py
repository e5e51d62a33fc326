"""Define NARUTO: move to where most uncertainty is visible, then view the most uncertain targets."""

from __future__ import annotations

import numpy as np

from activestructure_gym.policies.base import (
    POLICIES,
    Observation,
    best_valid,
    nearest_new,
    travel_discount,
)
from activestructure_gym.policies.candidates import Candidates
from activestructure_gym.policies.greedy import Planner, Travel
from activestructure_gym.policies.native_settings import NativeSettings

AT_GOAL = 0.75  # metres; views within it count as views at the goal, since a table has few directions per position
FACING = float(np.cos(np.radians(25.0)))  # cosine; a target this near to the optical axis is in the image


# Turns on the spot, so that nearly every target of a list is within 25 degrees of one of them.
TURNS = tuple(f"turns?count=8&pitch_deg={pitch}" for pitch in (0, 35, -35, 70, -70))


@POLICIES.register("naruto")
class Naruto(Planner):
    """Choose g* = argmax S(g), where S(g) is the sum of sigma(t) over the targets t seen from g ([naruto]).

    sigma(t) is the mean squared error of the rendered depth of all pixels, and 3.06 m^2 where no ray has measured. The
    300 targets are a part of the 4000 most uncertain places in front of surfaces. A target is seen from 0.5 to 2 m if
    30 samples in between are free (feature ``naruto``). There is no travel term. There are two stages:

    - goal: at g*, the candidate that faces the most uncertain target;
    - look: at g*, the candidate with the smallest rotation that faces a remaining target of the look-at list (feature
      ``naruto_look``: up to 10 targets), until none is left.

    Source: [naruto, code].
    """

    criterion = "uncertain places at 0.5 to 2 m, then views of a list of them"
    source = "Feng et al., NARUTO, CVPR 2024"
    required_features = ("naruto", "naruto_look")
    native_settings = NativeSettings(
        stages=(("targets?rows=128", *TURNS),),
        candidates=168,
        # A goal of the original has an sdf of 0.8 voxels at its 6 neighbours, and a path 0.5 voxels, of 0.1 m each.
        clearance_m=0.1,
        changes={"motion.min_clearance": 0.1},
        budget="2000 frames (Replica), 5000 (MP3D); 10 iterations every 5 frames",
    )

    def __init__(self, travel: Travel = "native") -> None:
        super().__init__(travel)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Begin without a goal."""
        super().reset(seed)
        self._goal = np.zeros(3)
        self._left = np.zeros((0, 3))  # metres, remaining targets of the look-at list

    def act(self, observation: Observation) -> int:
        """Return the next view at the goal, or a view at a new goal if no target is left or the goal was missed."""
        observation = self.only_views(observation)
        candidates = self.candidates(observation)
        here = observation["pose"][:3]
        if np.linalg.norm(here - self._goal) > AT_GOAL:
            self._left = self._left[:0]
        stage, choice = "look", self._next_view(observation, candidates)
        if choice is None:
            stage, choice = "goal", self._next_goal(observation, candidates)
        viewed = faced(candidates, self._left)[choice]
        self._left = self._left[~viewed]
        self._trace = {
            "stage": stage,
            "naruto": float(candidates["naruto"][choice]),
            "looked_at": int(viewed.sum()),
            "left": len(self._left),
        }
        return choice

    def _next_view(self, observation: Observation, candidates: Candidates) -> int | None:
        """Return the candidate at the goal that faces a remaining target with the smallest rotation, or None."""
        count = faced(candidates, self._left).sum(axis=1)
        rows = candidates.valid & self._around(candidates) & (count > 0)
        if not rows.any():
            return None
        if self.travel == "shared":
            return best_valid(np.where(rows, count * travel_discount(observation), -np.inf), observation)
        turn = candidates.view_direction @ forward(observation["pose"][3:])
        return best_valid(np.where(rows, turn, -np.inf), observation)

    def _next_goal(self, observation: Observation, candidates: Candidates) -> int:
        """Choose the goal with the largest score, store its look-at list, and return a candidate at the goal.

        The candidate faces the most uncertain target of the list if there is one, else any target of the list.
        """
        gain = np.where(candidates.revisit, 0.0, candidates["naruto"])
        if not gain[candidates.valid].any():  # no candidate sees a target
            self._left = self._left[:0]
            return nearest_new(observation)
        best = best_valid(self.scores(gain, observation), observation)
        self._goal = candidates.xyz[best].astype(np.float64)
        listed = candidates.feature("naruto_look")[best].reshape(-1, 3)
        self._left = listed[np.linalg.norm(listed - self._goal, axis=1) > 0.1].astype(np.float64)
        facing = faced(candidates, self._left)
        around = candidates.valid & self._around(candidates)
        offset = np.linalg.norm(candidates.xyz - self._goal, axis=1)
        for good in (facing[:, :1].any(axis=1), facing.any(axis=1)):
            if (around & good).any():
                return best_valid(np.where(around & good, -offset, -np.inf), observation)
        return best

    def _around(self, candidates: Candidates) -> np.ndarray:  # [K] bool
        """Return which candidates are within 0.75 m of the goal, without revisits."""
        near = np.linalg.norm(candidates.xyz - self._goal, axis=1) <= AT_GOAL
        return near & ~candidates.revisit


def faced(candidates: Candidates, targets: np.ndarray) -> np.ndarray:  # [T, 3] metres -> [K, T] bool
    """Return which targets are within 25 degrees of each candidate's view direction, without a test of occlusion."""
    offset = targets - candidates.xyz[:, None]
    along = (offset * candidates.view_direction[:, None]).sum(axis=2)
    return along >= FACING * np.maximum(np.linalg.norm(offset, axis=2), 1e-9)


def forward(quaternion: np.ndarray) -> np.ndarray:  # [4] wxyz -> [3]
    """Return the view direction (world) of a camera with this orientation: its z axis; ``quaternion`` is w, x, y, z."""
    w, x, y, z = quaternion.astype(np.float64)
    return np.array([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)])
