"""Define ActiveSplat: visit Voronoi nodes by integer scores, subregion by subregion, with local views at each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from activestructure_gym.policies.activesplat.nodes import Nodes, choose_node, node_scores
from activestructure_gym.policies.base import POLICIES, Observation, best_valid
from activestructure_gym.policies.candidates import Candidates
from activestructure_gym.policies.greedy import Planner, Travel
from activestructure_gym.policies.naruto.policy import forward
from activestructure_gym.policies.native_settings import SPLATAM, SQUARE_CAMERA
from activestructure_gym.policies.scored import record_scores

# Metres (10 steps of 6.5 cm). A node farther from the path travelled is unarrived. In the agent's subregion, a node
# nearer to a stop scores 0.
UNARRIVED_M = 0.65
AT_NODE = 0.5  # metres; a view or the agent within this distance is at a node
RADIUS = 0.1  # metres, radius of the agent
ARRIVED_M = 0.15  # metres from the chosen view; farther away, the goal was not reached

LOCAL_VIEWS = 5  # maximum number of local views at a stop
LOCAL_M = 0.75  # metres from the stop to a local view; the original turns on the spot
LOCAL_DEG2 = 100.0  # square degrees, minimum gaps in a local view
LOCAL_TURN = np.cos(np.radians(15.0))  # cosine of the minimum turn to a local view
STOP_M = 3 * RADIUS  # metres; a stop this near to an earlier one has no local views

LATE_AFTER = 3  # successive choices among nodes that are all arrived at or failed; then the late weights apply


@POLICIES.register("activesplat")
class ActiveSplat(Planner):
    """Choose the node argmax 20 unarrived + 10 in_horizon + 2 ceil(10 I / I_max) + ceil(10 V / V_max) - 60 failed.

    The view at the node that shows most gaps is chosen, followed by up to five views around it. I and V come
    from panoramas of the map at the node (feature `activesplat`). The score, its late weights and the order of
    subregions are those of [activesplat, code], `planner_node.py`.
    """

    criterion = "integer score of Voronoi nodes by the missing parts of panoramas of the map"
    travel_term = "current subregion first; ties by path length, later at random"
    source = "Li et al., ActiveSplat, RA-L 2025"
    # `config/datasets`: `mapping_iters` for 5 frames is 2 (10 at a higher resolution). `config/env`: depth up to 10 m
    # (`far`, 4 m, is for other cameras than the simulator's). The camera goes to nodes at one height, and tilts in
    # steps of 15 degrees up to 45.
    native_settings = replace(
        SPLATAM,
        stages=(("nodes?rows=476", *(f"turns?count=12&pitch_deg={pitch}" for pitch in (0, 30, -30))),),
        candidates=512,
        iterations=2,
        # `config/splatam/online_habitat_sim.py`: ellipsoids that begin as balls, seeds where the silhouette is below
        # 0.98 or the depth error above two medians, no pruning. `src/mapper/splatam`: 12 keyframes per event, all of
        # them recent or overlapping, with a border of 20 of 256 pixels.
        changes={
            **SQUARE_CAMERA,
            "sensor.max_range": 10.0,
            "mapper.isotropic": False,
            "mapper.seed_thickness": 1.0,
            "mapper.border_sigmas": None,
            "mapper.covered_alpha": 0.98,
            "mapper.in_front_factor": 2.0,
            "mapper.window": 12,
            "mapper.overlap_border": 20.0 / 256.0,
            "mapper.global_psnr": 0.0,
            "mapper.global_new_share": 1.0,
            "mapper.prune_opacity": 0.0,
            "mapper.prune_scale": 1e9,
        },
        budget="1000 steps (2000 in large scenes) of 6.5 cm, 256 x 256 at 90 degrees",
    )
    required_features = ("voronoi_node", "visited_distance", "in_horizon", "activesplat")

    def __init__(self, travel: Travel = "native") -> None:
        super().__init__(travel)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Begin an episode with local views at the start, which replace the original's turn on the spot."""
        super().reset(seed)
        self._goal: np.ndarray | None = None  # [3] metres, position of the last chosen view
        self._goal_node: np.ndarray | None = None  # [2] metres, node of the last chosen view; None for a local view
        self._failed = np.zeros((0, 2))  # metres, nodes that were not reached
        self._stop = np.zeros(0)  # [3] metres, current stop: the last goal that was not a local view
        self._stop_node = np.zeros(2)  # metres, node of the current stop
        self._viewed = np.zeros((0, 2))  # metres, nodes of earlier stops with local views
        self._stops = np.zeros((0, 2))  # metres, nodes of all earlier stops
        self._local_views = 0  # number of local views at this stop
        self._idle = 0  # number of successive choices among nodes that are all arrived at or failed
        self._late = False  # whether the late weights apply

    def act(self, observation: Observation) -> int:
        """Return a local view if one is left at this stop, otherwise a view at the best node."""
        observation = self.only_views(observation)
        candidates = self.candidates(observation)
        here = observation["pose"][:3].astype(np.float64)
        missed = self._goal is not None and np.linalg.norm(here - self._goal) > ARRIVED_M
        if missed and self._goal_node is not None:
            self._failed = np.vstack([self._failed, self._goal_node])
            self._stop, self._stop_node = here, here[:2]
        if not len(self._stop) or _apart(self._stop[None], here)[0] > LOCAL_M:  # first decision, or goal not reached
            self._stop, self._stop_node = here, here[:2]
        choice = self._decide(observation, candidates, candidates["activesplat_view"].astype(np.float64))
        self._goal = candidates.xyz[choice].astype(np.float64)
        self._goal_node = None if self._trace["mode"] == "local" else _node_places(candidates)[choice]
        return choice

    def _decide(self, observation: Observation, candidates: Candidates, show: np.ndarray) -> int:
        """Return the row of a local view or of a view at the best node, and update the state.

        ``show`` [K] are the gaps in each view in square degrees.
        """
        xyz, length = candidates.xyz.astype(np.float64), candidates.path_length.astype(np.float64)
        new = candidates.valid & ~candidates.revisit
        valid = new if new.any() else candidates.valid
        nodes = self._nodes(candidates, valid)
        self._trace = {"nodes": len(nodes.rows), "mode": "node" if nodes.rows else "no node"}
        if not nodes.rows:  # no floor plan yet, or no candidate at a node
            choice = best_valid(np.where(valid, self.scores(show, observation), -np.inf), observation)
            self._leave(candidates, choice)
            return choice
        if self.travel == "shared":
            nodes = self._update_late(nodes)
            gain = np.zeros(len(valid))
            for rows, score, here in zip(nodes.rows, node_scores(nodes, self._late), nodes.here):
                # The gaps in a view add at most 1, so they decide between the views of one node.
                gain[rows] = (0 if here else max(int(score), 0)) + show[rows] / max(float(show[rows].max()), 1e-12)
            choice = best_valid(self.scores(gain, observation), observation)
            self._leave(candidates, choice)
            return choice
        turn = candidates.view_direction.astype(np.float64) @ forward(observation["pose"][3:])
        local = valid & (show > LOCAL_DEG2) & (turn < LOCAL_TURN)
        local &= (_apart(xyz, self._stop) <= LOCAL_M) & (length <= 2.0 * LOCAL_M)  # no wall between
        repeated = (_apart(self._viewed, self._stop_node) <= STOP_M).any()
        if self._local_views < LOCAL_VIEWS and local.any() and not repeated:
            self._local_views += 1
            self._trace["mode"] = "local"
            return best_valid(np.where(local, show, -np.inf), observation)
        nodes = self._update_late(nodes)
        scores = node_scores(nodes, self._late)
        here = observation["pose"][:2].astype(np.float64)
        node = choose_node(nodes, scores, here, self.rng if self._late else None)
        rows = nodes.rows[node]
        self._trace |= {"score": int(scores[node]), "region": int(nodes.region[node]), "late": self._late}
        choice = int(rows[np.lexsort((length[rows], -show[rows]))[0]])
        record_scores(choice, np.where(np.isin(np.arange(len(show)), rows), show, -np.inf))
        if not repeated:
            self._viewed = np.vstack([self._viewed, self._stop_node])
        self._leave(candidates, choice, even_if_near=True)
        return choice

    def _leave(self, candidates: Candidates, choice: int, *, even_if_near: bool = False) -> None:
        """Make the view in row ``choice`` the new stop, and record the current stop as visited.

        A view within LOCAL_M of the current stop is not a new stop unless ``even_if_near``.
        """
        place = candidates.xyz[choice].astype(np.float64)
        if even_if_near or _apart(place[None], self._stop)[0] > LOCAL_M:
            self._stops = np.vstack([self._stops, self._stop_node])
            self._stop, self._stop_node, self._local_views = place, _node_places(candidates)[choice], 0

    def _update_late(self, nodes: Nodes) -> Nodes:
        """Return ``nodes``, without failures if this is the third choice in a row without an open node.

        An open node is unarrived and has not failed. From the third such choice on, the late weights apply for the rest
        of the episode.
        """
        self._idle = 0 if (nodes.unarrived & ~nodes.failed).any() else self._idle + 1
        if self._idle < LATE_AFTER:
            return nodes
        self._late, self._failed = True, self._failed[:0]
        return replace(nodes, failed=np.zeros(len(nodes.rows), dtype=bool))

    def _nodes(self, candidates: Candidates, valid: np.ndarray) -> Nodes:
        """Return the Voronoi nodes that have candidates in the rows ``valid`` [K] bool."""
        xyz, length = candidates.xyz.astype(np.float64), candidates.path_length.astype(np.float64)
        visited, horizon = candidates["visited_distance"].astype(np.float64), candidates["in_horizon"]
        information, volume, region = candidates.feature("activesplat").astype(np.float64).T[:3]
        number = np.where(valid, np.round(candidates["voronoi_node"]), -1)
        rows = tuple(np.flatnonzero(number == n) for n in np.unique(number[number >= 0]))
        first = np.array([r[0] for r in rows], dtype=np.int64)
        from_stop, places = _apart(xyz[:, :2], self._stop[:2]), _node_places(candidates)[first]
        stops = np.vstack([self._stops, self._stop_node])
        stop = _within(places, stops, RADIUS)
        return Nodes(
            rows=rows,
            places=places,
            information=np.where(stop, 0.0, information[first]),
            volume=np.where(stop, 0.0, volume[first]),
            unarrived=visited[first] > UNARRIVED_M,
            horizon=np.array([horizon[r].any() for r in rows], dtype=bool),
            failed=_within(places, self._failed, RADIUS),
            region=region[first],
            length=np.array([length[r].min() for r in rows]),
            here=np.array([np.minimum(length[r], from_stop[r]).min() <= AT_NODE for r in rows], dtype=bool),
            stop=stop,
            near_stop=_within(places, stops, UNARRIVED_M),
        )


def _node_places(candidates: Candidates) -> np.ndarray:  # [K, 2] metres
    """Return the position of each candidate's Voronoi node, or its own without a node."""
    return candidates.feature("activesplat")[:, 4:].astype(np.float64)


def _within(places: np.ndarray, others: np.ndarray, reach: float) -> np.ndarray:  # [n, 2], [m, 2], metres -> [n] bool
    return (np.linalg.norm(places[:, None] - others, axis=2) <= reach).any(axis=1)


def _apart(places: np.ndarray, place: np.ndarray) -> np.ndarray:  # [n, d], [d] -> [n] metres
    return np.linalg.norm(places - place, axis=1)
