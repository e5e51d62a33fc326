"""Candidate sources: where the views on offer come from, by name.

A source is a frozen dataclass derived from `Source`. Its fields are its options, and `propose` returns views, best
first::

    @SOURCES.register("mine")
    @dataclass(frozen=True)
    class Mine(Source):
        rows: int = 8

        def propose(self, context):
            return Proposals(np.tile(context.agent.pose, (8, 1, 1)))

``views.stages`` of the configuration names those that are offered together: ``(("pool", "mine"),)``. Several stages are
several tables, of which a policy asks for another one by choosing a row.

This room holds the sources that two planners or more use; `SOURCES` finds them and those in the planners' folders.
"""

from activestructure_gym.sources.base import (
    SOURCES,
    Proposals,
    Source,
    SourceContext,
    make_source,
    sources_in,
)
from activestructure_gym.sources.offering import make_stages, offer, random_of

__all__ = [
    "SOURCES",
    "Proposals",
    "Source",
    "SourceContext",
    "make_source",
    "make_stages",
    "offer",
    "random_of",
    "sources_in",
]
