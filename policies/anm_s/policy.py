"""Define ANM-S: move between nodes of the floor plan by an integer score, and view the uncertain surface at each."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.policies.anm_s.targets import next_target
from activestructure_gym.policies.base import (
    POLICIES,
    Observation,
    at_current_pose,
    best_valid,
    nearest_new,
    travel_discount,
)
from activestructure_gym.policies.candidates import Candidates
from activestructure_gym.policies.greedy import Planner, Travel
from activestructure_gym.policies.native_settings import SQUARE_CAMERA, NativeSettings

UNARRIVED, IN_HORIZON, CLUSTER, FAILED = 3.0, 2.0, 1.0, -6.0  # weights of the score
ARRIVED_M = 15 * 0.065  # metres from the path travelled (15 steps of 6.5 cm); a node farther away is unarrived
AT_NODE = 0.5  # metres in the plane; a candidate or the agent within this distance is at a node
FORGET_AFTER = 3  # successive choices among nodes that are all arrived at or failed; then failures are forgotten
FACING = float(np.cos(np.radians(30.0)))  # minimum cosine between the view direction and the direction to a target
SAME_VIEW = float(np.cos(np.radians(45.0)))  # cosine; one view serves all directions within 45 degrees of it
Uncertainty = Literal["perturbation", "proxy"]


@POLICIES.register("anm_s")
class AnmS(Planner):
    """Choose the node argmax 3 unarrived + 2 in_horizon + 1 has_cluster - 6 failed, then view its clusters ([anm_s]).

    Nodes are those of the floor plan's Voronoi graph:

    - Unarrived: farther than 0.975 m from the path travelled.
    - In horizon: on a straight free path, and in the bounding box of the surface ahead of the last movement
      (`anm_s_horizon`).
    - Has cluster: nearest node to a connected part of the most uncertain 20 % of the surface (at least 0.5 % of it),
      below the agent's head.
    - Failed: an earlier attempt did not reach it. Failures are forgotten if only arrived and failed nodes are left.

    Of equal nodes the one with the shortest path is chosen. The node at the agent's position is not a goal. If the path
    to the best node is longer than 13 m, a node on the way to it is visited first (`next_target`). At the node, views
    towards all its clusters follow. Further views show the ends of the branches of the Voronoi graph that were removed
    at the node.

    ``uncertainty``: "perturbation" uses 20 perturbed renderings from 12 views. "proxy" is its first-order approximation
    without rendering. Source: [anm_s, code].
    """

    criterion = "integer score of Voronoi nodes: new, in horizon, with uncertain surface"
    travel_term = "ties by path length"
    source = "Kuang et al., ANM-S, IROS 2024"
    native_settings = NativeSettings(
        stages=(("nodes?rows=504", "turns?count=8"),),
        candidates=512,
        iterations=10,
        changes=SQUARE_CAMERA,
        budget="1000 steps (2000, 10000 in large scenes), 256 x 256 at 90 degrees",
    )

    def __init__(self, travel: Travel = "native", uncertainty: Uncertainty = "perturbation") -> None:
        """Store the travel term and the kind of uncertainty; raise `InputError` for an unknown kind."""
        if uncertainty not in get_args(Uncertainty):
            raise InputError(f"option uncertainty must be {' or '.join(get_args(Uncertainty))}, got '{uncertainty}'")
        super().__init__(travel)
        self._feature = "anm_s" if uncertainty == "perturbation" else "anm_s_proxy"
        self.required_features = ("voronoi_node", "visited_distance", "anm_s_horizon", self._feature)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Begin without a node and without failures."""
        super().reset(seed)
        self._goal: np.ndarray | None = None  # [3] metres, position of the last chosen candidate
        self._stop = np.zeros(0)  # [3] metres, position of the last chosen node; empty before the first decision
        self._idle = 0  # number of successive choices among nodes that are all arrived at or failed
        self._left = 0  # remaining views at this node
        self._viewed = np.zeros((0, 3))  # directions already viewed at this node
        self._failed = np.zeros((0, 2))  # metres, goals that were not reached

    def act(self, observation: Observation) -> int:
        """Return the next view at this node, or a view at the next node."""
        observation = self.only_views(observation)
        candidates = self.candidates(observation)
        places = candidates.xyz.astype(np.float64)
        here = observation["pose"][:3].astype(np.float64)
        if self._goal is not None and np.linalg.norm(here - self._goal) > AT_NODE:
            self._failed = np.vstack([self._failed, self._goal[:2]])
            self._left = 0
        if not len(self._stop) or np.linalg.norm(here - self._stop) > 2.0 * AT_NODE:  # first decision, or not reached
            self._stop = here
        stage, choice = "look", self._next_view(observation, candidates)
        if choice is None:
            stage, choice = "node", self._next_node(observation, candidates)
            self._left = int(candidates[f"{self._feature}_looks"][choice])
            self._viewed, self._stop = self._viewed[:0], places[choice]
        if candidates[f"{self._feature}_facing"][choice] >= FACING:
            self._left -= 1
            self._viewed = np.vstack([self._viewed, candidates.view_direction[choice]])
        self._goal = places[choice]
        self._trace = {
            "stage": stage,
            "score": float(self.node_score(candidates)[choice]),
            "node": int(candidates["voronoi_node"][choice]),
            "looks_left": self._left,
            "failed": len(self._failed),
        }
        return choice

    def node_score(self, candidates: Candidates) -> np.ndarray:  # [K], whole numbers
        """Return the integer score of the Voronoi node of each candidate; 0 without a node."""
        score = (
            UNARRIVED * (candidates["visited_distance"] > ARRIVED_M)
            + IN_HORIZON * (candidates["anm_s_horizon"] > 0)
            + CLUSTER * (candidates[f"{self._feature}_clusters"] > 0)
            + FAILED * self._has_failed(candidates)
        )
        return np.where(candidates["voronoi_node"] >= 0, score, 0.0)

    def _has_failed(self, candidates: Candidates) -> np.ndarray:  # [K] bool
        """Return which candidates are within 0.5 m, in the floor plane, of a goal that was not reached."""
        places = candidates.xyz[:, None, :2].astype(np.float64)
        return (np.linalg.norm(places - self._failed, axis=2) <= AT_NODE).any(axis=1)

    def _next_view(self, observation: Observation, candidates: Candidates) -> int | None:
        """Return the candidate with the fewest frames that faces a target at this node in a new direction, or None."""
        if self._left <= 0:
            return None
        rows = candidates.valid & ~candidates.revisit & self._at_stop(candidates)
        rows &= candidates[f"{self._feature}_facing"] >= FACING
        rows &= (candidates.view_direction @ self._viewed.T < SAME_VIEW).all(axis=1)
        if not rows.any():
            return None
        return best_valid(np.where(rows, -candidates.frames, -np.inf), observation)

    def _at_stop(self, candidates: Candidates) -> np.ndarray:  # [K] bool
        return np.linalg.norm((candidates.xyz - self._stop)[:, :2], axis=1) <= AT_NODE

    def _forget(self, candidates: Candidates, rows: np.ndarray) -> None:
        """Forget failures if this is the third choice in a row whose nodes are all arrived at or failed.

        ``rows`` [K] bool are the candidates at the offered nodes.
        """
        left = rows & (candidates["visited_distance"] > ARRIVED_M) & ~self._has_failed(candidates)
        self._idle = 0 if left.any() else self._idle + 1
        if self._idle >= FORGET_AFTER:
            self._failed = self._failed[:0]

    def _next_node(self, observation: Observation, candidates: Candidates) -> int:
        """Return the candidate at the best node that is best aligned with a target; else the nearest new view."""
        node = candidates["voronoi_node"]
        rows = candidates.valid & ~candidates.revisit & ~at_current_pose(candidates) & (node >= 0)
        if not rows.any():
            return nearest_new(observation)
        places, length = candidates.xyz[:, :2].astype(np.float64), candidates.path_length.astype(np.float64)
        away = rows & ~np.isin(node, node[rows & (self._at_stop(candidates) | (length <= AT_NODE))])
        rows = away if away.any() else rows
        self._forget(candidates, rows)
        score = self.node_score(candidates)
        if self.travel == "shared":
            value = (score - FAILED) * travel_discount(observation)  # shifted to be at least 0
            best = best_valid(np.where(rows, value, -np.inf), observation)
        else:
            offered, here = np.flatnonzero(rows), observation["pose"][:2].astype(np.float64)
            best = int(offered[next_target(score[offered], length[offered], places[offered], here)])
        # A view without anything to look at has the cosine 0.
        looks = candidates[f"{self._feature}_looks"] > 0
        facing = np.where(looks, candidates[f"{self._feature}_facing"], -1.0)
        return best_valid(np.where(rows & (node == node[best]), facing - 1e-6 * length, -np.inf), observation)
