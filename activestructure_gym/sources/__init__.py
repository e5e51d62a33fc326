"""Propose candidate views by named sources.

A source is a frozen dataclass derived from `Source`. Its fields are its options, and `propose` returns views, best
first::

    @SOURCES.register("mine")
    @dataclass(frozen=True)
    class Mine(Source):
        rows: int = 8

        def propose(self, context):
            return Proposals(np.tile(context.agent.pose, (8, 1, 1)))

A stage is a group of sources that are offered together; ``views.stages`` of the configuration lists the stages, for
example ``(("pool", "mine"),)``. With several stages, a policy switches to another stage by choosing a row of the
candidate table that belongs to it.

This package holds the sources that at least two planners use; `SOURCES` also finds those in the planners' folders.
"""

from activestructure_gym.sources.base import (
    SOURCES,
    Proposals,
    Source,
    SourceContext,
    make_source,
    sources_in,
)
from activestructure_gym.sources.offering import make_stages, offer, only_views_of_pool, random_of

__all__ = [
    "SOURCES",
    "Proposals",
    "Source",
    "SourceContext",
    "make_source",
    "make_stages",
    "offer",
    "only_views_of_pool",
    "random_of",
    "sources_in",
]
