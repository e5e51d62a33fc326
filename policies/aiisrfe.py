"""The mode-switching planner of Zeng et al. ([aiisrfe]): frontiers first, then frontiers and unsure surface in turn."""

from __future__ import annotations

import numpy as np

from activestructure_gym.policies.base import POLICIES, Observation, best_valid, nearest_new, only_new
from activestructure_gym.policies.candidates import Candidates
from activestructure_gym.policies.greedy import Planner
from activestructure_gym.policies.hgs_planner import first_of_tour

MANY_NEAR, SHARE_NEAR = 3, 0.2  # more frontiers near, and a larger share of all: exploration alone
RECONSTRUCTIONS = 3  # tasks of unsure surface beside the frontiers (own choice) ...
APART_M = 1.0  # ... at places so far from each other (own choice)


@POLICIES.register("aiisrfe")
class Aiisrfe(Planner):
    """Tasks on the shortest tour: one view for each frontier, and the views of the most unsure surface.

    While more than 3 frontiers are near, and these are more than 20 % of all, only frontiers are tasks; without any
    frontier only surface is. The first task of the tour is gone to and everything is planned anew. With
    ``travel=shared`` there is no tour: 1 for a frontier's view, the share of the largest uncertainty for others, times
    the factor.
    """

    decides_by = "frontiers, and by turns with them surface of unsure colour"
    source = "by a digest of Zeng et al., ICRA 2024"
    required_gains = ("aiisrfe",)

    def act(self, observation: Observation) -> int:
        """The first valid task of the tour; the nearest new view where there is none."""
        observation = only_new(observation)
        candidates = self.candidates(observation)
        frontier = candidates.valid & (candidates["aiisrfe_frontier"] >= 0) & ~candidates.revisit
        near, total = (float(candidates[f"aiisrfe_{name}"].max(initial=0.0)) for name in ("near", "total"))
        explores = near > MANY_NEAR and near > SHARE_NEAR * total
        unsure = np.where(candidates.valid & ~candidates.revisit, candidates["aiisrfe_uncertainty"], 0.0)
        tasks = np.flatnonzero(frontier).tolist()
        if not (explores and tasks):
            tasks += most_unsure(candidates, np.where(frontier, 0.0, unsure))
        if self.travel == "shared":
            worth = np.where(frontier, 1.0, 0.0 if explores else unsure / max(float(unsure.max(initial=0.0)), 1e-12))
            choice = best_valid(self.scores(worth, observation), observation)
        elif tasks:
            ways = candidates.path_length[tasks].astype(np.float64)
            choice = tasks[first_of_tour(ways, candidates.xyz[tasks, :2].astype(np.float64))]
        else:
            choice = nearest_new(observation)
        mode = "explore" if explores and frontier.any() else "both" if frontier.any() else "reconstruct"
        task = "frontier" if frontier[choice] else "surface"
        self._trace = {"mode": mode, "task": task, "near": near, "total": total}
        return choice


def most_unsure(candidates: Candidates, unsure: np.ndarray) -> list[int]:  # [K] -> rows
    """The views with the largest uncertainty above 0, each at a place of its own."""
    chosen: list[int] = []
    for row in np.argsort(-unsure, kind="stable"):
        if unsure[row] <= 0 or len(chosen) == RECONSTRUCTIONS:
            break
        if all(np.linalg.norm(candidates.xyz[row] - candidates.xyz[other]) >= APART_M for other in chosen):
            chosen.append(int(row))
    return chosen
