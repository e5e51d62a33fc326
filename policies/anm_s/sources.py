"""Propose ANM-S's candidates: views in all directions at the nodes of the floor plan's Voronoi graph."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.motion import planar_graph
from activestructure_gym.sources.base import SOURCES, SourceContext
from activestructure_gym.sources.wheels import OnWheels


@SOURCES.register("nodes")
@dataclass(frozen=True)
class Nodes(OnWheels):
    """Propose views at the nodes of the floor plan's Voronoi graph, also at nodes visited before ([anm_s, code])."""

    def places(self, context: SourceContext) -> np.ndarray:
        """Return the nodes [N, 2] in metres."""
        return planar_graph(context.volume, context.start).nodes

    def spent(self, context: SourceContext) -> np.ndarray:
        """Return the poses near which no view is proposed: only the agent's current pose."""
        return context.agent.pose[None]
