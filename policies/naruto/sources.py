"""NARUTO's candidates: places that see uncertain targets, and turns to the targets at the place where the agent is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.policies.naruto.features import LISTED, targets_from
from activestructure_gym.ranges import check_ranges
from activestructure_gym.sources.base import MAX_ROWS, SOURCES, Proposals, Source, SourceContext
from activestructure_gym.sources.facing import standing_places
from activestructure_gym.sources.places import looking

_MAX_PLACES = 600  # of which the score is worked out; where there are more, an even choice of them


@SOURCES.register("targets")
@dataclass(frozen=True)
class TargetFacing(Source):
    """First the own place, turned to each of the 10 most uncertain targets seen from there; then the places with the
    largest S(g), turned to the most uncertain target seen from each. On the way the camera looks at that target.

    Source: [naruto, code].
    """

    rows: int = 128

    def __post_init__(self) -> None:
        check_ranges(self, {"rows": f"[1, {MAX_ROWS}]"})

    def propose(self, context: SourceContext) -> Proposals:
        """Turns in place, then goals, the best first."""
        places = standing_places(context)
        step = max(1, -(-len(places) // _MAX_PLACES))
        here = context.agent.pose[:3, 3]
        places = np.concatenate([here[None], places[::step]])
        targets = targets_from(context.mapper, context.volume, places)
        turns = np.flatnonzero(targets.seen[0])[:LISTED]  # the most uncertain first
        score = targets.seen[1:] @ targets.sigma
        goals = 1 + np.argsort(-score, kind="stable")[: self.rows]
        goals = goals[score[goals - 1] > 0]
        first = targets.seen[goals].argmax(axis=1)
        stands = np.concatenate([np.tile(here, (len(turns), 1)), places[goals]])
        points = np.concatenate([targets.positions[turns], targets.positions[first]]).reshape(-1, 3)
        return Proposals(looking(stands, points - stands), look_at=points)
