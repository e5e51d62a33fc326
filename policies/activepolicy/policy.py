"""Define a policy inspired by ActivePolicy: choose the most central view of a graph of views."""

from __future__ import annotations

import numpy as np

from activestructure_gym.policies.base import POLICIES, Observation, nearest_new, nearest_of_best
from activestructure_gym.policies.candidates import Candidates
from activestructure_gym.policies.greedy import Planner

BEST = 16  # m: number of views with the largest gain that become nodes
RELATION = 1.0  # lambda_r: weight of the edges between views; the edges to the map have weight 1 (lambda_g)
DECAY = 1.0  # gamma_d: an edge decays by exp(-gamma_d) at the mean distance between views
EPSILON = 1e-3  # added to |v_i| in the denominator of the score
SAME = 1e-9  # relative difference up to which two centralities are equal except for rounding


@POLICIES.register("activepolicy")
class ActivePolicy(Planner):
    """Choose argmax_i 1 / (|v_i| + epsilon), where v is the Fiedler vector of a graph of views.

    Nodes are the map (0) and the 16 views with the largest gain g. Edges are A_0i = g_i / mean g and
    A_ij = lambda_r overlap_ij exp(-gamma d_ij / mean d). v is the eigenvector of the second smallest eigenvalue of
    L = I - D^-1/2 A D^-1/2. g is the feature ``activepolicy``: the share of pixels in which readings of the depth
    disagree. The overlap of two views is the share of planes that both see. If neither sees a plane, it is the cosine
    between their view directions.

    The views are filtered by gain first, because the gain hardly changes the choice of the published rule. There is no
    travel term. Of equal views, before and after the filter, the one with the fewest frames is chosen. Inspired by
    [activepolicy], of which only a summary was available.
    """

    criterion = "the most central of the 16 views with most disagreeing depth"
    travel_term = "none; ties by path length"
    source = "inspired by ActivePolicy, CVPR 2026"
    required_features = ("activepolicy",)

    def act(self, observation: Observation) -> int:
        """Return the most central of the views with the largest gain; the nearest new view if none has a gain."""
        candidates = self.candidates(observation)
        gain = candidates["activepolicy"].astype(np.float64)
        usable = candidates.valid & ~candidates.revisit & (gain > 0)
        # Early in an episode, many gains are exactly 1.
        order = np.lexsort((candidates.frames, np.where(usable, -gain, np.inf)))
        rows = order[: min(BEST, int(usable.sum()))]
        if not len(rows):
            self._trace = {"nodes": 0}
            return nearest_new(observation)
        centrality = fiedler_centrality(gain[rows], RELATION * relation(observation, rows))
        scores = np.full(len(gain), -np.inf)
        scores[rows] = self.scores_of(centrality, observation, rows)
        choice = nearest_of_best(scores, observation, tolerance=SAME)
        rank = int(np.flatnonzero(rows == choice)[0])
        self._trace = {
            "nodes": len(rows),
            "activepolicy": float(gain[choice]),
            "rank_by_gain": rank,
            "centrality": float(centrality[rank]),
        }
        return choice

    def scores_of(self, centrality: np.ndarray, observation: Observation, rows: np.ndarray) -> np.ndarray:
        """Return the centrality [n] of the views ``rows`` [n] times their travel factor."""
        return centrality * self.travel_factor(observation)[rows]


def fiedler_centrality(gain: np.ndarray, between: np.ndarray) -> np.ndarray:  # [n] > 0, [n, n] -> [n]
    """Return the centrality 1 / (|v_i| + epsilon) of n views, from the Fiedler vector v of the graph of `ActivePolicy`.

    ``gain`` determines the edges between the map and the views. ``between`` are the weights of the edges between the
    views; its diagonal is ignored. If m eigenvectors share the second smallest eigenvalue, |v_i| is the norm of their m
    components at node i, divided by sqrt(m). It then does not depend on the choice of eigenvectors.
    """
    count = len(gain)
    graph = np.zeros((count + 1, count + 1))
    graph[0, 1:] = graph[1:, 0] = gain / gain.mean()
    graph[1:, 1:] = between * (1.0 - np.eye(count))
    root = np.sqrt(graph.sum(axis=1))
    values, vectors = np.linalg.eigh(np.eye(count + 1) - graph / np.outer(root, root))
    same = np.abs(values - values[1]) < 1e-9
    same[0] = False  # the constant eigenvector of a connected graph
    length = np.linalg.norm(vectors[:, same], axis=1) / np.sqrt(same.sum())
    return 1.0 / (length[1:] + EPSILON)


def relation(observation: Observation, rows: np.ndarray) -> np.ndarray:  # [n] rows -> [n, n] in 0..1
    """Return the relation of each pair of the views ``rows``: overlap x exp(-gamma distance / mean distance).

    The overlap is the share of the planes visible from either view that are visible from both, see `ActivePolicy`.
    """
    candidates = Candidates(observation)
    xyz, direction = (values[rows].astype(np.float64) for values in (candidates.xyz, candidates.view_direction))
    seen = (observation["candidate_planes"][rows] * observation["plane_mask"]).astype(np.float64)
    shared = seen @ seen.T
    either = seen.sum(axis=1)[:, None] + seen.sum(axis=1) - shared
    facing = np.clip(direction @ direction.T, 0.0, 1.0)
    overlap = np.where(either > 0, shared / np.maximum(either, 1.0), facing)
    distance = np.linalg.norm(xyz[:, None] - xyz, axis=2)
    return overlap * np.exp(-DECAY * distance / max(float(distance.mean()), 1e-9))
