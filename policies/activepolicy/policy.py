"""Inspired by ActivePolicy: the view in the middle of the graph of views."""

from __future__ import annotations

import numpy as np

from activestructure_gym.policies.base import POLICIES, Observation, nearest_new, nearest_of_best
from activestructure_gym.policies.candidates import Candidates
from activestructure_gym.policies.greedy import Planner

BEST = 16  # m: views with the largest gain that become nodes
RELATION = 1.0  # lambda_r, of the edges between views; lambda_g is 1 for gains in units of their mean
DECAY = 1.0  # gamma_d: of the relation per mean distance
EPSILON = 1e-3
SAME = 1e-9  # relative difference of two centralities that are equal but for rounding


@POLICIES.register("activepolicy")
class ActivePolicy(Planner):
    """argmax_i 1 / (|v_i| + epsilon), v the Fiedler vector of a graph of views: inspired by [activepolicy].

    Nodes: the map (0) and the 16 views with the largest gain g. Edges: A_0i = g_i / mean g and
    A_ij = lambda_r overlap_ij exp(-gamma d_ij / mean d). v is the eigenvector of the second smallest eigenvalue of
    L = I - D^-1/2 A D^-1/2. g is the feature ``activepolicy``: pixels in which two readings of the depth disagree. The
    overlap is what two views share of the planes they see; of two that see none, the cosine between their axes.

    Only a digest of the paper is known, and on its face the rule hardly looks at the gain; hence the pre-filter. No
    travel term; of equals, before the filter and after it, the one with the fewest frames.
    Source: a digest of [activepolicy].
    """

    criterion = "the most central of the 16 views with most disagreeing depth"
    travel_term = "none; ties by path length"
    source = "inspired by ActivePolicy, CVPR 2026"
    required_features = ("activepolicy",)

    def act(self, observation: Observation) -> int:
        """The most central of the best views."""
        candidates = self.candidates(observation)
        gain = candidates["activepolicy"].astype(np.float64)
        usable = candidates.valid & ~candidates.revisit & (gain > 0)
        # Where nothing is mapped yet many gains are exactly 1.
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
        """The centrality, times the shared travel term if that is wanted."""
        return centrality * self.travel_factor(observation)[rows]


def fiedler_centrality(gain: np.ndarray, between: np.ndarray) -> np.ndarray:  # [n] > 0, [n, n] -> [n]
    """1 / (|v_i| + epsilon) of the nodes 1..n; the diagonal of ``between`` is left out.

    Where several eigenvectors share the second smallest eigenvalue, |v_i| is the length of their part at node i, over
    the root of their number: as for one, and the same for every choice of the eigenvectors.
    """
    count = len(gain)
    graph = np.zeros((count + 1, count + 1))
    graph[0, 1:] = graph[1:, 0] = gain / gain.mean()
    graph[1:, 1:] = between * (1.0 - np.eye(count))
    root = np.sqrt(graph.sum(axis=1))
    values, vectors = np.linalg.eigh(np.eye(count + 1) - graph / np.outer(root, root))
    same = np.abs(values - values[1]) < 1e-9
    same[0] = False  # the constant of a connected graph
    length = np.linalg.norm(vectors[:, same], axis=1) / np.sqrt(same.sum())
    return 1.0 / (length[1:] + EPSILON)


def relation(observation: Observation, rows: np.ndarray) -> np.ndarray:  # [n] rows -> [n, n] in 0..1
    """Overlap of the views times exp(-gamma distance / mean distance)."""
    candidates = Candidates(observation)
    xyz, look = (values[rows].astype(np.float64) for values in (candidates.xyz, candidates.view_direction))
    seen = (observation["candidate_planes"][rows] * observation["plane_mask"]).astype(np.float64)
    shared = seen @ seen.T
    either = seen.sum(axis=1)[:, None] + seen.sum(axis=1) - shared
    facing = np.clip(look @ look.T, 0.0, 1.0)
    overlap = np.where(either > 0, shared / np.maximum(either, 1.0), facing)
    distance = np.linalg.norm(xyz[:, None] - xyz, axis=2)
    return overlap * np.exp(-DECAY * distance / max(float(distance.mean()), 1e-9))
