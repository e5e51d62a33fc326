"""Propose actions without a path: optimise the map in place, or end the episode."""

from __future__ import annotations

from dataclasses import dataclass

from activestructure_gym.ranges import check_ranges
from activestructure_gym.sources.base import SOURCES, Proposals, Source, SourceContext


@SOURCES.register("stay")
@dataclass(frozen=True)
class Stay(Source):
    """Propose the present pose, with ``rounds`` rounds of optimisation over all keyframes instead of a path.

    A round has as many iterations as a new keyframe, and costs the frames from one keyframe to the next.
    """

    rounds: int = 1
    rows = 1  # no option

    def __post_init__(self) -> None:
        check_ranges(self, {"rounds": "[1, 1000]"})

    def propose(self, context: SourceContext) -> Proposals:
        """Return the pose of the agent, with the rounds of optimisation."""
        return Proposals(context.agent.pose[None], stay=self.rounds)


@SOURCES.register("finish")
@dataclass(frozen=True)
class Finish(Source):
    """Propose one row that ends the episode.

    In the observation, its cost in frames is the rest of the budget, and its features are 0. The row is not offered in
    the first frame.
    """

    rows = 1  # no option

    def propose(self, context: SourceContext) -> Proposals:
        """Return the pose of the agent as a proposal that ends the episode; no proposal in the first frame."""
        begun = int(context.agent.frames > 1)
        return Proposals(context.agent.pose[None][:begun], ends=True)
