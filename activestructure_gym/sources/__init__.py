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
"""

from activestructure_gym.sources.base import (
    SOURCES,
    Proposals,
    Source,
    SourceContext,
    make_source,
    sources_in,
)
from activestructure_gym.sources.facing import FrontierFacing, RegionsOfInterest, UnsureFacing
from activestructure_gym.sources.offering import make_stages, offer, random_of
from activestructure_gym.sources.places import Around, Lattice, Turns
from activestructure_gym.sources.shared_pool import Pool
from activestructure_gym.sources.standing import Finish, Stay
from activestructure_gym.sources.targets import TargetFacing
from activestructure_gym.sources.wheels import Floor, Nodes

__all__ = [
    "SOURCES",
    "Around",
    "Finish",
    "Floor",
    "FrontierFacing",
    "Lattice",
    "Nodes",
    "Pool",
    "Proposals",
    "RegionsOfInterest",
    "Source",
    "SourceContext",
    "Stay",
    "TargetFacing",
    "Turns",
    "UnsureFacing",
    "make_source",
    "make_stages",
    "offer",
    "random_of",
    "sources_in",
]
