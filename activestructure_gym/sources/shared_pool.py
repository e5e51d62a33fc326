"""Propose the views of the shared pool, and the keyframes with the lowest PSNR."""

from __future__ import annotations

from dataclasses import dataclass

from activestructure_gym.sources.base import MAX_ROWS, SOURCES, Proposals, Source, SourceContext


@SOURCES.register("pool")
@dataclass(frozen=True)
class Pool(Source):
    """Propose the views of `CandidatePool`: free lattice positions times Fibonacci directions, then revisits.

    A revisit has the pose of a keyframe. The source fills the rows of the table that the other sources leave free.
    """

    rows: int = MAX_ROWS

    def propose(self, context: SourceContext) -> Proposals:
        """Return the reachable, unvisited views, then the revisits; if the rows do not suffice, a random draw."""
        room = min(context.room, self.rows)
        distances = context.agent.distances
        table = context.pool.offer(context.volume, distances, context.decision, context.revisits, room=room)
        return Proposals(table.world_from_camera, ids=table.ids, revisit=table.revisit, path_length=table.path_length)
