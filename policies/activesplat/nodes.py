"""Score and choose Voronoi nodes as ActiveSplat does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.policies.anm_s.targets import next_target

RICH = 250.0  # rad^2 m deg^2, minimum I of a node that keeps the agent in its subregion

# Weights of the node score in `node_scores`.
UNARRIVED, HORIZON, INFORMATION, VOLUME, FAILED = 20, 10, 2, 1, -60
LATE_HORIZON, LATE_INFORMATION, LATE_VOLUME = -1, 10, 10  # late weights, once every node is arrived at or failed


@dataclass(frozen=True)
class Nodes:
    """Hold the N nodes of the Voronoi graph at which there is at least one candidate view."""

    rows: tuple[np.ndarray, ...]  # [N] rows of the candidate table at each node
    places: np.ndarray  # [N, 2] metres, world
    information: np.ndarray  # [N] rad^2 m deg^2: missing information I; 0 for a node that is a stop
    volume: np.ndarray  # [N] rad^2 m: missing volume V; 0 for a node that is a stop
    unarrived: np.ndarray  # [N] bool: more than 0.65 m from the path travelled
    horizon: np.ndarray  # [N] bool: in the region that the last keyframe after a movement observed, see `in_horizon`
    failed: np.ndarray  # [N] bool: an earlier attempt did not reach it
    region: np.ndarray  # [N] number of the subregion
    length: np.ndarray  # [N] path length in metres
    here: np.ndarray  # [N] bool: at the agent's position
    stop: np.ndarray  # [N] bool: within 0.1 m of a place where the agent has stopped
    near_stop: np.ndarray  # [N] bool: within 0.65 m of a place where the agent has stopped


def node_scores(nodes: Nodes, late: bool = False) -> np.ndarray:  # [N] int64
    """Return 20 unarrived + 10 in_horizon + 2 ceil(10 I / I_max) + ceil(10 V / V_max) - 60 failed.

    ``late`` selects the late weights of in_horizon, I and V.
    """
    information, volume = (
        np.ceil(10.0 * values / values.max(initial=1e-12)).astype(np.int64)
        for values in (nodes.information, nodes.volume)
    )
    weights = (LATE_HORIZON, LATE_INFORMATION, LATE_VOLUME) if late else (HORIZON, INFORMATION, VOLUME)
    score = weights[0] * nodes.horizon + weights[1] * information + weights[2] * volume + UNARRIVED * nodes.unarrived
    return np.asarray(score + FAILED * nodes.failed)


def choose_node(
    nodes: Nodes,
    scores: np.ndarray,  # [N] int64
    here: np.ndarray,  # [2] metres, position of the agent
    late: np.random.Generator | None = None,
) -> int:
    """Return the index of the node with the highest score, subregion by subregion.

    The agent's subregion is that of the nearest node. In it, nodes near stops score 0. Its nodes are eligible while one
    of them scores above 0 and has I >= `RICH`. Otherwise the nodes of the other subregion with the highest score above
    0 are eligible, or all nodes if there is none. Stops do not count for this. Nodes at the agent's position are
    eligible only if there are no others. `next_target` chooses among the eligible nodes. With a generator ``late``,
    only the score counts and ties are drawn.
    """
    away = ~nodes.here if not nodes.here.all() else np.ones(len(scores), dtype=bool)
    current = nodes.region == nodes.region[np.argmin(nodes.length)]
    local = np.where(nodes.near_stop, 0, scores)
    if (away & current & (local > 0) & (nodes.information >= RICH)).any():
        eligible, scores = away & current, local
    else:
        others = np.flatnonzero(away & ~current & ~nodes.stop & (scores > 0))
        best = others[np.lexsort((nodes.length[others], -scores[others]))[:1]]
        eligible = away & np.isin(nodes.region, nodes.region[best]) if len(best) else away
    rows = np.flatnonzero(eligible)
    if late is not None:
        return int(late.choice(rows[scores[rows] == scores[rows].max()]))
    return int(rows[next_target(scores[rows], nodes.length[rows], nodes.places[rows], here)])
