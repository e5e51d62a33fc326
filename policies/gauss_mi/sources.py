"""Propose GauSS-MI's candidates: level views to the side of, above and below the agent."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from activestructure_gym.sources.base import SOURCES, Proposals, Source, SourceContext
from activestructure_gym.sources.places import directions, looking

_UNITS = np.array([0.3, 0.4, np.radians(40.0)])  # metres to the left, metres up, radians


def moves() -> np.ndarray:  # [94, 3] metres, metres, radians
    """Return the moves of the original program: to the left of the new view direction, up, and turned to the left.

    The units are 0.3 m, 0.4 m and 40 degrees. There are all moves of up to (2, 1, 1) units that change the position,
    and lifts by 2 and 3 units. Sidesteps of up to 3 have turns of 2 and 3, and corners are (3 or 4, 3, 4) units away.
    """
    near = [(left, up, turn) for left, up, turn in product(range(-2, 3), (-1, 0, 1), (-1, 0, 1)) if left or up]
    lifts = product((0,), (-3, -2, 2, 3), (-1, 0, 1))
    turned = product((-3, -2, -1, 1, 2, 3), (0,), (-3, -2, 2, 3))
    corners = product((-4, -3, 3, 4), (-3, 3), (-4, 4))
    return np.array([*near, *lifts, *turned, *corners]) * _UNITS


@SOURCES.register("moves")
@dataclass(frozen=True)
class Moves(Source):
    """Propose level views after a short move to the side, up or down, with a turn ([gauss_mi, code]).

    Where no move is possible, the view of the decision before the last one is proposed, as a way out.
    """

    rows: int = 94

    def propose(self, context: SourceContext) -> Proposals:
        """Return the views of the possible `moves`, in their order."""
        ahead, place = context.agent.pose[:3, 2], context.agent.pose[:3, 3]
        left, up, turn = moves().T
        yaw = np.arctan2(ahead[1], ahead[0]) + turn
        places = place + np.stack([-left * np.sin(yaw), left * np.cos(yaw), up], axis=1)
        possible = np.isfinite(context.agent.distances.at(places))
        possible &= context.volume.clearance_at(places) >= context.clearance_m
        if not possible.any():
            return Proposals(context.agent.stops[-2:-1])
        return Proposals(looking(places[possible], directions(yaw[possible], np.zeros(possible.sum()))))
