"""Voronoi nodes as ActiveSplat scores and chooses them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

RICH = 250.0  # I from which a node keeps the agent in its subregion
DEFERRED_M = 13.0  # metres of way: 200 steps; farther nodes wait for nearer ones

# Weights of the score.
UNARRIVED, HORIZON, INFORMATION, VOLUME, FAILED = 20, 10, 2, 1, -60
LATE_HORIZON, LATE_INFORMATION, LATE_VOLUME = -1, 10, 10  # once every node was arrived at or had failed


@dataclass(frozen=True)
class Nodes:
    """The Voronoi nodes that some view on offer stands for."""

    rows: tuple[np.ndarray, ...]  # [N] the views of each
    information: np.ndarray  # [N] I
    volume: np.ndarray  # [N] V
    unarrived: np.ndarray  # [N] bool
    horizon: np.ndarray  # [N] bool
    failed: np.ndarray  # [N] bool
    region: np.ndarray  # [N]
    length: np.ndarray  # [N] metres of way
    here: np.ndarray  # [N] bool: the agent stands there
    spent: np.ndarray  # [N] bool: it has stopped there before


def node_scores(nodes: Nodes, late: bool = False) -> np.ndarray:  # [N] int64
    """20 unarrived + 10 in horizon + 2 ceil(10 I / I_max) + ceil(10 V / V_max) - 60 failed, and its late weights.

    A node where it stopped before is worth 0, however much is missing there.
    """
    information, volume = (
        np.ceil(10.0 * values / values.max(initial=1e-12)).astype(np.int64)
        for values in (nodes.information, nodes.volume)
    )
    weights = (LATE_HORIZON, LATE_INFORMATION, LATE_VOLUME) if late else (HORIZON, INFORMATION, VOLUME)
    score = weights[0] * nodes.horizon + weights[1] * information + weights[2] * volume + UNARRIVED * nodes.unarrived
    return np.where(nodes.spent, 0, score) + FAILED * nodes.failed


def choose_node(nodes: Nodes, scores: np.ndarray, late: np.random.Generator | None = None) -> int:
    """Of the present subregion while it has a rich unvisited node, else of another one, by the highest score.

    The agent is in the subregion of the node nearest to it. Where no other subregion has a node of a positive score,
    all count again, as do nodes the agent stands at where there is no other. Ties go to the shortest way, and nodes
    beyond `DEFERRED_M` wait; with a generator ``late`` the highest score alone counts, and it draws among equals.
    """
    away = ~nodes.here if not nodes.here.all() else np.ones(len(scores), dtype=bool)
    present = nodes.region == nodes.region[np.argmin(nodes.length)]
    rich = away & present & nodes.unarrived & ~nodes.failed & (nodes.information >= RICH)
    other = away & ~present
    among = away & present if rich.any() else other if (scores[other] > 0).any() else away
    if late is not None:
        return int(late.choice(np.flatnonzero(among & (scores == scores[among].max()))))
    near = among & (nodes.length <= DEFERRED_M)
    rows = np.flatnonzero(near if near.any() else among)
    return int(rows[np.lexsort((nodes.length[rows], -scores[rows]))[0]])
