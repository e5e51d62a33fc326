"""Sources without a way: stay and optimise the map, or end the episode."""

from __future__ import annotations

from dataclasses import dataclass

from activestructure_gym.ranges import check_ranges
from activestructure_gym.sources.base import SOURCES, Proposals, Source, SourceContext


@SOURCES.register("stay")
@dataclass(frozen=True)
class Stay(Source):
    """One row: the own pose, and ``rounds`` rounds of optimisation over all keyframes instead of a way.

    A round has the mapper's iterations and costs the frames between two keyframes, as on a way.
    """

    rounds: int = 1
    rows: int = 1

    def __post_init__(self) -> None:
        check_ranges(self, {"rounds": "[1, 1000]", "rows": "[1, 1]"})

    def propose(self, context: SourceContext) -> Proposals:
        """Where the agent stands."""
        return Proposals(context.agent.pose[None], stay=self.rounds)


@SOURCES.register("finish")
@dataclass(frozen=True)
class Finish(Source):
    """One row that ends the episode: no frame more is paid, and its ``frames`` are those that are given up.

    Its features are 0. Not offered before a frame was paid for a decision.
    """

    rows: int = 1

    def __post_init__(self) -> None:
        check_ranges(self, {"rows": "[1, 1]"})

    def propose(self, context: SourceContext) -> Proposals:
        """Where the agent stands."""
        begun = int(context.agent.frames > 1)
        return Proposals(context.agent.pose[None][:begun], ends=True)
