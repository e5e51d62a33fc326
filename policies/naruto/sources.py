"""Propose NARUTO's candidates: places that see uncertain targets, and turns towards targets at the agent's position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.policies.naruto.features import LISTED, targets_from
from activestructure_gym.ranges import check_ranges
from activestructure_gym.sources.base import MAX_ROWS, SOURCES, Proposals, Source, SourceContext
from activestructure_gym.sources.facing import camera_positions
from activestructure_gym.sources.places import looking

_MAX_PLACES = 10_000  # maximum number of places whose score is computed; of more places, every n-th is used


@SOURCES.register("targets")
@dataclass(frozen=True)
class TargetFacing(Source):
    """Propose turns at the agent's position, and views at the places with the largest S(g) ([naruto, code]).

    The turns face the 10 most uncertain targets seen from the agent's position. The view at a place faces the most
    uncertain target seen from there; the camera points at it along the whole path.
    """

    rows: int = 128

    def __post_init__(self) -> None:
        check_ranges(self, {"rows": f"[1, {MAX_ROWS}]"})

    def propose(self, context: SourceContext) -> Proposals:
        """Return turns on the spot, then views at the places with the largest S(g), the best first."""
        places = camera_positions(context)
        step = max(1, -(-len(places) // _MAX_PLACES))
        here = context.agent.pose[:3, 3]
        places = np.concatenate([here[None], places[::step]])
        targets = targets_from(context.mapper, context.volume, places)
        turns = np.flatnonzero(targets.seen[0])[:LISTED]  # targets are sorted by uncertainty
        score = targets.seen[1:] @ targets.sigma
        goals = 1 + np.argsort(-score, kind="stable")[: self.rows]
        goals = goals[score[goals - 1] > 0]
        first = targets.seen[goals].argmax(axis=1)
        positions = np.concatenate([np.tile(here, (len(turns), 1)), places[goals]])
        points = np.concatenate([targets.positions[turns], targets.positions[first]]).reshape(-1, 3)
        return Proposals(looking(positions, points - positions), look_at=points)
