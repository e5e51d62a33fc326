"""Propose ActiveGS's candidates: views that face its regions of interest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.features.view_directions import view_directions
from activestructure_gym.policies.active_gs.features import gaussian_confidence
from activestructure_gym.sources.base import SOURCES, SourceContext
from activestructure_gym.sources.facing import SIDE, Facing, frontier_cells


@SOURCES.register("roi")
@dataclass(frozen=True)
class RegionsOfInterest(Facing):
    """Propose views that face the frontier, or surface with low confidence ([active_gs, code]).

    A cell has low confidence if it contains more than 5 Gaussians of confidence below 0.3 and opacity above 0.7. The
    normal of a region is the mean direction to its free neighbours. A view must see its region; the original does not
    test this.
    """

    def regions(self, context: SourceContext) -> np.ndarray:
        """Return which cells of 2 x 2 x 2 voxels are frontier or contain surface with low confidence."""
        cells = frontier_cells(context.volume)
        gaussians, volume = context.mapper.map, context.volume
        doubtful = (gaussian_confidence(view_directions(context.mapper)) < 0.3) & (gaussians.opacities > 0.7)
        inside = volume.voxel_of(gaussians.means[doubtful]) // SIDE
        inside = inside[((inside >= 0) & (inside < np.array(cells.shape))).all(axis=1)]
        count = np.zeros(cells.shape, dtype=np.int64)
        np.add.at(count, tuple(inside.T), 1)
        return cells | (count > 5)
