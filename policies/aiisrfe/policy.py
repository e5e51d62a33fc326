"""Define the planner of Zeng et al. ([aiisrfe]): visit frontiers and views of uncertain surface on short tours."""

from __future__ import annotations

import numpy as np

from activestructure_gym.policies.base import (
    POLICIES,
    Observation,
    best_valid,
    nearest_new,
    patience,
    without_revisits,
)
from activestructure_gym.policies.candidates import Candidates
from activestructure_gym.policies.greedy import Planner, Travel
from activestructure_gym.policies.hgs_planner.policy import shortest_tour
from activestructure_gym.policies.native_settings import NativeSettings

NEAR_M = 1.0  # metres of path; a frontier is near if the path to its view is shorter
# Only frontiers are tasks while at least MANY_NEAR frontiers, and at least the share SHARE_NEAR of all, are near.
MANY_NEAR, SHARE_NEAR = 2, 0.15
MIXED_PLANS = 2  # maximum number of successive plans with both kinds of tasks; then only frontiers are tasks
SURFACE_M, ALL_SURFACE_M = 1.5, 4.0  # metres of path to a task for uncertain surface: with frontiers, without
RECONSTRUCTIONS = 3  # maximum number of tasks for uncertain surface (own choice)
APART_M = 1.0  # metres, minimum distance between the places of these tasks (own choice)
EXECUTED_M = 5.0  # metres of the tour after which it is planned anew (own choice)


@POLICIES.register("aiisrfe")
class Aiisrfe(Planner):
    """Follow tour* = argmin length over the tasks: one view per frontier, and the views of the most uncertain surface.

    While at least 2 frontiers, and at least 15 % of all, are near, only frontiers are tasks. Other plans have both
    kinds, but only two in succession. Once no view of a frontier was left for some plans (`patience`), all tasks
    are surface. The tasks within the first 5 m of the tour are visited, then a new tour is planned.

    With ``travel=shared`` there is no tour, and each decision is a plan. The gain of a frontier's view is 1, and the
    gain of a surface task is its uncertainty divided by the largest one; the score is gain times travel factor. Source:
    [aiisrfe] and facts about its code.
    """

    criterion = "frontiers, and surface of uncertain colour"
    travel_term = "shortest tour of tasks"
    source = "by a digest of Zeng et al., ICRA 2024, with constants of its code"
    required_features = ("aiisrfe",)
    # As in the original, views are drawn for the tasks, and depth beyond 6 m is not used. The numbers and distances of
    # the views are our choice.
    native_settings = NativeSettings(
        stages=(("frontier_facing?per_region=3&apart_m=2&rows=144", "unsure_facing?apart_m=1&rows=64"),),
        candidates=208,
        changes={"sensor.max_range": 6.0, "volume.max_range": 6.0},
    )

    def __init__(self, travel: Travel = "native") -> None:
        super().__init__(travel)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Begin without tasks, in exploration."""
        super().reset(seed)
        self._mode = "explore"  # tasks of the last plan: explore (frontiers), both, or reconstruct (surface)
        self._mixed = 0  # number of successive plans with both kinds of tasks
        self._without = 0  # number of successive plans without a view of a frontier
        self._left = np.zeros((0, 6))  # position (m) and view direction of the remaining tasks of the tour

    def act(self, observation: Observation) -> int:
        """Return the candidate nearest to the next task of the tour; without tasks, the nearest new view."""
        observation = without_revisits(self.only_views(observation))
        candidates = self.candidates(observation)
        new = candidates.valid & ~candidates.revisit
        frontier = new & (candidates["aiisrfe_frontier"] >= 0)
        length = candidates.path_length.astype(np.float64)
        if self.travel == "shared" or not len(self._left):
            self._mode = self._next_mode(frontier, length)
        reach = {"explore": -1.0, "both": SURFACE_M, "reconstruct": ALL_SURFACE_M}[self._mode]
        uncertain = np.where(new & (length <= reach), candidates["aiisrfe_uncertainty"], 0.0)
        frontier &= self._mode != "reconstruct"
        if self.travel == "shared":
            gain = np.where(frontier, 1.0, uncertain / max(float(uncertain.max(initial=0.0)), 1e-12))
            choice = best_valid(self.scores(gain, observation), observation)
        else:
            if not len(self._left):
                self._left = self._tour(candidates, frontier, uncertain)
            choice = self._next(candidates, new, observation)
        self._trace = {"mode": self._mode, "left": len(self._left)}
        return choice

    def _next_mode(self, frontier: np.ndarray, length: np.ndarray) -> str:
        """Return the tasks of the next plan: explore, both, or reconstruct.

        ``frontier`` [K] bool are the views that serve frontiers, ``length`` [K] their path lengths in metres.
        """
        if self._without < patience(len(frontier)):
            self._without = 0 if frontier.any() else self._without + 1
        if not frontier.any() or self._without >= patience(len(frontier)):
            return "reconstruct"
        near, total = int((frontier & (length < NEAR_M)).sum()), int(frontier.sum())
        explores = (near >= MANY_NEAR and near >= SHARE_NEAR * total) or self._mixed >= MIXED_PLANS
        self._mixed = 0 if explores else self._mixed + 1
        return "explore" if explores else "both"

    def _tour(self, candidates: Candidates, frontier: np.ndarray, uncertain: np.ndarray) -> np.ndarray:  # [t, 6]
        """Return the first tasks of the shortest tour: those within 5 m of path, and at least one.

        ``frontier`` [K] bool are the candidates that serve frontiers; ``uncertain`` [K] is the uncertainty of the
        surface that each candidate sees. A task is a position (m) and a view direction.
        """
        tasks = np.flatnonzero(frontier).tolist()
        tasks += most_uncertain(candidates, np.where(frontier, 0.0, uncertain))
        if not tasks:
            return np.zeros((0, 6))
        places = candidates.xyz[tasks].astype(np.float64)
        lengths = candidates.path_length[tasks].astype(np.float64)
        order = list(shortest_tour(lengths, places[:, :2]))
        steps = np.linalg.norm(np.diff(places[order], axis=0), axis=1)
        metres = lengths[order[0]] + np.concatenate([[0.0], np.cumsum(steps)])
        order = [row for row, length in zip(order, metres) if length <= max(EXECUTED_M, float(metres[0]))]
        return np.hstack([places, candidates.view_direction[tasks]])[order]

    def _next(self, candidates: Candidates, new: np.ndarray, observation: Observation) -> int:
        if not len(self._left) or not new.any():
            return nearest_new(observation)
        place, direction = self._left[0, :3], self._left[0, 3:]
        self._left = self._left[1:]
        angle = np.arccos(np.clip(candidates.view_direction @ direction, -1.0, 1.0))
        return best_valid(np.where(new, -np.linalg.norm(candidates.xyz - place, axis=1) - angle, -np.inf), observation)


def most_uncertain(candidates: Candidates, uncertain: np.ndarray) -> list[int]:  # [K] -> rows
    """Return up to three candidate rows with the largest values of ``uncertain``, in decreasing order.

    A row is skipped if it is closer than 1 m to a chosen one. Rows without uncertainty are never chosen.
    """
    chosen: list[int] = []
    for row in np.argsort(-uncertain, kind="stable"):
        if uncertain[row] <= 0 or len(chosen) == RECONSTRUCTIONS:
            break
        if all(np.linalg.norm(candidates.xyz[row] - candidates.xyz[other]) >= APART_M for other in chosen):
            chosen.append(int(row))
    return chosen
