"""Score and choose Voronoi nodes as ActiveSplat does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

RICH = 250.0  # rad^2 m deg^2, minimum I of a node that keeps the agent in its subregion
DEFERRED_M = 13.0  # metres of path (200 steps); farther nodes are chosen only if there are no nearer ones

# Weights of the node score in `node_scores`.
UNARRIVED, HORIZON, INFORMATION, VOLUME, FAILED = 20, 10, 2, 1, -60
LATE_HORIZON, LATE_INFORMATION, LATE_VOLUME = -1, 10, 10  # late weights, once every node is arrived at or failed


@dataclass(frozen=True)
class Nodes:
    """Hold the N nodes of the Voronoi graph at which there is at least one candidate view."""

    rows: tuple[np.ndarray, ...]  # [N] rows of the candidate table at each node
    information: np.ndarray  # [N] rad^2 m deg^2: missing information I
    volume: np.ndarray  # [N] rad^2 m: missing volume V
    unarrived: np.ndarray  # [N] bool: more than 0.65 m from the path travelled
    horizon: np.ndarray  # [N] bool: in the region that the last keyframe after a movement observed, see `in_horizon`
    failed: np.ndarray  # [N] bool: an earlier attempt did not reach it
    region: np.ndarray  # [N] number of the subregion
    length: np.ndarray  # [N] path length in metres
    here: np.ndarray  # [N] bool: at the agent's position
    spent: np.ndarray  # [N] bool: the agent has stopped there


def node_scores(nodes: Nodes, late: bool = False) -> np.ndarray:  # [N] int64
    """Return 20 unarrived + 10 in_horizon + 2 ceil(10 I / I_max) + ceil(10 V / V_max) - 60 failed.

    ``late`` selects the late weights of in_horizon, I and V. All terms but the last are 0 for a node at which the agent
    has stopped.
    """
    information, volume = (
        np.ceil(10.0 * values / values.max(initial=1e-12)).astype(np.int64)
        for values in (nodes.information, nodes.volume)
    )
    weights = (LATE_HORIZON, LATE_INFORMATION, LATE_VOLUME) if late else (HORIZON, INFORMATION, VOLUME)
    score = weights[0] * nodes.horizon + weights[1] * information + weights[2] * volume + UNARRIVED * nodes.unarrived
    return np.where(nodes.spent, 0, score) + FAILED * nodes.failed


def choose_node(nodes: Nodes, scores: np.ndarray, late: np.random.Generator | None = None) -> int:
    """Return the index of the node with the highest score, subregion by subregion.

    The agent's subregion is that of the nearest node. Its nodes are eligible while one of them is unarrived, not failed
    and has I >= `RICH`. Otherwise the nodes of the other subregions are eligible if one scores above 0, else all nodes.
    Nodes at the agent's position are eligible only if there are no others. Of equal scores the shortest path wins, and
    nodes beyond `DEFERRED_M` wait for nearer ones. With a generator ``late``, only the score counts and ties are drawn.
    """
    away = ~nodes.here if not nodes.here.all() else np.ones(len(scores), dtype=bool)
    current = nodes.region == nodes.region[np.argmin(nodes.length)]
    rich = away & current & nodes.unarrived & ~nodes.failed & (nodes.information >= RICH)
    other = away & ~current
    eligible = away & current if rich.any() else other if (scores[other] > 0).any() else away
    if late is not None:
        return int(late.choice(np.flatnonzero(eligible & (scores == scores[eligible].max()))))
    near = eligible & (nodes.length <= DEFERRED_M)
    rows = np.flatnonzero(near if near.any() else eligible)
    return int(rows[np.lexsort((nodes.length[rows], -scores[rows]))[0]])
