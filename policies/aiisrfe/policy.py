"""The mode-switching planner of Zeng et al. ([aiisrfe]): frontiers first, then frontiers and unsure surface in turn."""

from __future__ import annotations

import numpy as np

from activestructure_gym.policies.base import POLICIES, Observation, best_valid, nearest_new, without_revisits
from activestructure_gym.policies.candidates import Candidates
from activestructure_gym.policies.greedy import Planner, Travel
from activestructure_gym.policies.hgs_planner.policy import shortest_tour
from activestructure_gym.policies.native_settings import NativeSettings

MANY_NEAR, SHARE_NEAR = 3, 0.2  # more frontiers near, and a larger share of all: exploration alone
RECONSTRUCTIONS = 3  # tasks of unsure surface beside the frontiers (own choice) ...
APART_M = 1.0  # ... at places so far from each other (own choice)
EXECUTED_M = 5.0  # metres of the tour that are gone before it is planned anew (own choice)


@POLICIES.register("aiisrfe")
class Aiisrfe(Planner):
    """tour* = argmin length over the tasks: a view per frontier, and argmax U over views of surface, U its uncertainty.

    By abstract and digest of [aiisrfe], without equation numbers. While more than 3 frontiers are near, and these are
    more than 20 % of all, only frontiers are tasks; without any frontier only surface is. The tasks of the tour within
    5 m of way are gone to, then everything is planned anew. With ``travel=shared`` there is no tour: 1 for a frontier's
    view, the share of the largest uncertainty for others, times the factor.
    """

    criterion = "frontiers, and by turns with them surface of unsure colour"
    travel_term = "shortest tour of tasks"
    source = "by a digest of Zeng et al., ICRA 2024"
    required_features = ("aiisrfe",)
    # Views are drawn for tasks there, too; how many, and how far apart, are own choices.
    native_settings = NativeSettings(
        stages=(("frontier_facing?per_region=3&apart_m=1&rows=144", "unsure_facing?apart_m=1&rows=64"),),
        candidates=208,
    )

    def __init__(self, travel: Travel = "native") -> None:
        super().__init__(travel)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Begin without tasks."""
        super().reset(seed)
        self._left = np.zeros((0, 6))  # place and direction of the tasks that are left of the tour

    def act(self, observation: Observation) -> int:
        """The next task of the tour, as the view on offer that is nearest to it; the nearest new view without any."""
        observation = without_revisits(observation)
        candidates = self.candidates(observation)
        new = candidates.valid & ~candidates.revisit
        frontier = new & (candidates["aiisrfe_frontier"] >= 0)
        near, total = (float(candidates[f"aiisrfe_{name}"].max(initial=0.0)) for name in ("near", "total"))
        explores = near > MANY_NEAR and near > SHARE_NEAR * total
        unsure = np.where(new, candidates["aiisrfe_uncertainty"], 0.0)
        mode = "explore" if explores and frontier.any() else "both" if frontier.any() else "reconstruct"
        if self.travel == "shared":
            worth = np.where(
                frontier, 1.0, 0.0 if mode == "explore" else unsure / max(float(unsure.max(initial=0.0)), 1e-12)
            )
            choice = best_valid(self.scores(worth, observation), observation)
        else:
            if not len(self._left):
                self._left = self._tour(candidates, frontier, np.where(mode == "explore", 0.0, unsure))
            choice = self._next(candidates, new, observation)
        self._trace = {"mode": mode, "left": len(self._left), "near": near, "total": total}
        return choice

    def _tour(self, candidates: Candidates, frontier: np.ndarray, unsure: np.ndarray) -> np.ndarray:  # [t, 6]
        """Tasks in the order of the shortest tour, as far as it is no longer than `EXECUTED_M`, and one at least."""
        tasks = np.flatnonzero(frontier).tolist()
        tasks += most_unsure(candidates, np.where(frontier, 0.0, unsure))
        if not tasks:
            return np.zeros((0, 6))
        places = candidates.xyz[tasks].astype(np.float64)
        ways = candidates.path_length[tasks].astype(np.float64)
        order = list(shortest_tour(ways, places[:, :2]))
        steps = np.linalg.norm(np.diff(places[order], axis=0), axis=1)
        metres = ways[order[0]] + np.concatenate([[0.0], np.cumsum(steps)])
        order = [row for row, way in zip(order, metres) if way <= max(EXECUTED_M, float(metres[0]))]
        return np.hstack([places, candidates.view_direction[tasks]])[order]

    def _next(self, candidates: Candidates, new: np.ndarray, observation: Observation) -> int:
        if not len(self._left) or not new.any():
            return nearest_new(observation)
        place, look = self._left[0, :3], self._left[0, 3:]
        self._left = self._left[1:]
        angle = np.arccos(np.clip(candidates.view_direction @ look, -1.0, 1.0))
        return best_valid(np.where(new, -np.linalg.norm(candidates.xyz - place, axis=1) - angle, -np.inf), observation)


def most_unsure(candidates: Candidates, unsure: np.ndarray) -> list[int]:  # [K] -> rows
    """The views with the largest uncertainty above 0, each at a place of its own."""
    chosen: list[int] = []
    for row in np.argsort(-unsure, kind="stable"):
        if unsure[row] <= 0 or len(chosen) == RECONSTRUCTIONS:
            break
        if all(np.linalg.norm(candidates.xyz[row] - candidates.xyz[other]) >= APART_M for other in chosen):
            chosen.append(int(row))
    return chosen
