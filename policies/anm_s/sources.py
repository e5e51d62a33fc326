"""ANM-S's candidates: the nodes of the floor plan's Voronoi graph, with yaws all around."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.motion import planar_graph
from activestructure_gym.sources.base import SOURCES, SourceContext
from activestructure_gym.sources.wheels import OnWheels


@SOURCES.register("nodes")
@dataclass(frozen=True)
class Nodes(OnWheels):
    """The nodes of the floor plan's Voronoi graph, where ANM-S goes and comes back to ([anm_s, code])."""

    def places(self, context: SourceContext) -> np.ndarray:
        """As far from all walls as can be."""
        return planar_graph(context.volume, context.start).nodes

    def spent(self, context: SourceContext) -> np.ndarray:
        """The view it has now, alone."""
        return context.agent.pose[None]
