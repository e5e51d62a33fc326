"""The source that all planners share: the persistent pool of the environment and the worst rendered keyframes."""

from __future__ import annotations

from dataclasses import dataclass

from activestructure_gym.sources.base import MAX_ROWS, SOURCES, Proposals, Source, SourceContext


@SOURCES.register("pool")
@dataclass(frozen=True)
class Pool(Source):
    """`CandidatePool`: free lattice places times Fibonacci directions, as many as there are rows left."""

    rows: int = MAX_ROWS

    def propose(self, context: SourceContext) -> Proposals:
        """All that is open and reachable, or a neutral draw of it, then the revisits."""
        room = min(context.room, self.rows)
        distances = context.agent.distances
        table = context.pool.offer(context.volume, distances, context.decision, context.revisits, room=room)
        return Proposals(table.world_from_camera, ids=table.ids, revisit=table.revisit)
