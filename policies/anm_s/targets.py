"""Choose a target by score, and an intermediate one if the path to it is long."""

from __future__ import annotations

import numpy as np

DEFERRED_M = 200 * 0.065  # metres of path (200 steps of 6.5 cm); farther targets are approached by nearer ones


def next_target(
    scores: np.ndarray,  # [n]
    lengths: np.ndarray,  # [n] path length in metres
    places: np.ndarray,  # [n, d] metres
    here: np.ndarray,  # [d] metres, position of the agent
) -> int:
    """Return the row with the highest score, of equal ones that with the shortest path, or a row on the way to it.

    A row on the way is chosen if the path to the best row is longer than `DEFERRED_M`. Its own path is shorter than
    that, and it is nearer to the best row than the agent. Of these rows, the highest score wins, then the smallest
    distance to the best row. Distances to the best row are straight. Source: [activesplat, code] and [anm_s, code],
    `planner_node.py`, with distances along the graph.
    """
    best = int(np.lexsort((lengths, -scores))[0])
    left = np.linalg.norm(places - places[best], axis=1)
    between = (lengths < DEFERRED_M) & (left < np.linalg.norm(here - places[best]))
    if lengths[best] <= DEFERRED_M or not between.any():
        return best
    rows = np.flatnonzero(between)
    return int(rows[np.lexsort((left[rows], -scores[rows]))[0]])
