"""ActiveSplat: integer scores of Voronoi nodes, subregion by subregion, and local views at each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.envs.observation import CANDIDATE_FEATURES
from activestructure_gym.policies.base import POLICIES, Observation, best_valid
from activestructure_gym.policies.greedy import Planner

_LENGTH = CANDIDATE_FEATURES.index("path_length")

UNARRIVED_M = 0.65  # metres from the way driven: 10 steps of 6.5 cm
RICH = 250.0  # I from which a node keeps the agent in its subregion
DEFERRED_M = 13.0  # metres of way: 200 steps; farther nodes wait for nearer ones
FAILED_M = 0.3  # metres around the end of a way that was not reached; a node with a view there has failed
ARRIVED_M = 0.15  # metres from the chosen view: farther away the way was not finished

LOCAL_VIEWS = 5  # at one stop
LOCAL_M = 0.75  # metres of way: the original turns on the spot; here the directions on offer stand around it
LOCAL_DEG2 = 100.0  # square degrees that a local view must show of gaps
LOCAL_TURN = np.cos(np.radians(15.0))  # of the angle from which it is another view

# Weights of the score.
UNARRIVED, HORIZON, INFORMATION, VOLUME, FAILED = 20, 10, 2, 1, -60
LATE_HORIZON, LATE_INFORMATION, LATE_VOLUME = -1, 10, 10  # when every node is arrived at or failed


@dataclass(frozen=True)
class Nodes:
    """The Voronoi nodes that some valid view stands for."""

    rows: tuple[np.ndarray, ...]  # [N] the views of each
    information: np.ndarray  # [N] I
    volume: np.ndarray  # [N] V
    unarrived: np.ndarray  # [N] bool
    horizon: np.ndarray  # [N] bool
    failed: np.ndarray  # [N] bool
    region: np.ndarray  # [N]
    length: np.ndarray  # [N] metres of way


def node_scores(nodes: Nodes) -> np.ndarray:  # [N] int64
    """20 unarrived + 10 in horizon + 2 ceil(10 I / I_max) + ceil(10 V / V_max) - 60 failed, and its late weights."""
    information, volume = (
        np.ceil(10.0 * values / values.max(initial=1e-12)).astype(np.int64)
        for values in (nodes.information, nodes.volume)
    )
    if (nodes.unarrived & ~nodes.failed).any():
        score = UNARRIVED * nodes.unarrived + HORIZON * nodes.horizon + INFORMATION * information + VOLUME * volume
    else:
        score = LATE_HORIZON * nodes.horizon + LATE_INFORMATION * information + LATE_VOLUME * volume
    return score + FAILED * nodes.failed


def choose_node(nodes: Nodes, scores: np.ndarray) -> int:
    """Of the present subregion while it has a rich unvisited node, else of the one with the highest score.

    The agent is in the subregion of the node nearest to it. Ties go to the shortest way.
    """
    here = nodes.region == nodes.region[np.argmin(nodes.length)]
    rich = here & nodes.unarrived & ~nodes.failed & (nodes.information >= RICH)
    among = here if rich.any() else np.ones(len(scores), dtype=bool)
    near = among & (nodes.length <= DEFERRED_M)
    rows = np.flatnonzero(near if near.any() else among)
    return int(rows[np.lexsort((nodes.length[rows], -scores[rows]))[0]])


@POLICIES.register("activesplat")
class ActiveSplat(Planner):
    """The node with the highest `node_scores`, the view there that shows most gaps, then up to LOCAL_VIEWS around it.

    I and V come from panoramas of the map at the node (`activesplat_information`, `activesplat_volume`). Source:
    ActiveSplat (RA-L 2025); peers_active.md, 3.1.
    """

    required_gains = ("voronoi_node", "visited_distance", "in_horizon", "activesplat_information",
                      "activesplat_volume", "activesplat_region", "activesplat_view")  # fmt: skip

    def __init__(self, travel: str = "native") -> None:
        super().__init__(travel)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Begin with the views around the start, in place of the original's turn on the spot."""
        super().reset(seed)
        self._goal: np.ndarray | None = None  # [3] metres: where the last chosen view stands
        self._failed = np.zeros((0, 3))  # metres
        self._looks = 0  # local views at this stop

    def act(self, observation: Observation) -> int:
        """A local view while the stop lasts, else a view at the best node."""
        table = observation["candidates"].astype(np.float64)
        if self._goal is not None and np.linalg.norm(observation["pose"][:3] - self._goal) > ARRIVED_M:
            self._failed = np.vstack([self._failed, self._goal])
        choice = self._decide(observation, table, self.gain(observation, "activesplat_view").astype(np.float64))
        self._goal = table[choice, :3]
        return choice

    def _decide(self, observation: Observation, table: np.ndarray, show: np.ndarray) -> int:
        nodes, valid = self._nodes(observation, table), observation["action_mask"].astype(bool)
        self._trace = {"nodes": len(nodes.rows), "mode": "node" if nodes.rows else "no node"}
        if not nodes.rows:  # nothing of the plan is known yet, or no view on offer stands at a node
            return best_valid(self.scores(show, observation), observation)
        scores = node_scores(nodes)
        if self.travel == "shared":
            gain = np.zeros(len(valid))
            for rows, score in zip(nodes.rows, scores):  # what a view shows decides between those of a node
                gain[rows] = max(int(score), 0) + show[rows] / max(float(show[rows].max()), 1e-12)
            return best_valid(self.scores(gain, observation), observation)
        look = _axis(observation["pose"][3:])
        local = valid & (table[:, _LENGTH] <= LOCAL_M) & (show > LOCAL_DEG2) & (table[:, 3:6] @ look < LOCAL_TURN)
        if self._looks < LOCAL_VIEWS and local.any():
            self._looks += 1
            self._trace["mode"] = "local"
            return best_valid(np.where(local, show, -1.0), observation)
        self._looks = 0
        node = choose_node(nodes, scores)
        rows = nodes.rows[node]
        self._trace |= {"score": int(scores[node]), "region": int(nodes.region[node])}
        return int(rows[np.lexsort((table[rows, _LENGTH], -show[rows]))[0]])

    def _nodes(self, observation: Observation, table: np.ndarray) -> Nodes:
        number, visited, horizon, information, volume, region = (
            self.gain(observation, name).astype(np.float64) for name in self.required_gains[:-1]
        )
        number = np.where(observation["action_mask"] > 0, np.round(number), -1)
        rows = tuple(np.flatnonzero(number == n) for n in np.unique(number[number >= 0]))
        first = np.array([r[0] for r in rows], dtype=np.int64)
        return Nodes(
            rows=rows,
            information=information[first],
            volume=volume[first],
            unarrived=visited[first] > UNARRIVED_M,
            horizon=np.array([horizon[r].any() for r in rows], dtype=bool),
            failed=np.array([self._has_failed(table[r, :3]) for r in rows], dtype=bool),
            region=region[first],
            length=np.array([table[r, _LENGTH].min() for r in rows]),
        )

    def _has_failed(self, positions: np.ndarray) -> bool:  # [n, 3]
        return bool((np.linalg.norm(positions[:, None] - self._failed, axis=2) <= FAILED_M).any())


def _axis(quaternion: np.ndarray) -> np.ndarray:  # [4] wxyz -> [3] the camera's optical axis
    w, x, y, z = quaternion.astype(np.float64)
    return np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
