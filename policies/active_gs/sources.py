"""Propose ActiveGS's candidates: views that face its regions of interest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from activestructure_gym.features.view_directions import view_directions
from activestructure_gym.policies.active_gs.features import gaussian_confidence
from activestructure_gym.sources.base import SOURCES, SourceContext
from activestructure_gym.sources.facing import SIDE, Facing, empty_cells, frontier_cells


@SOURCES.register("roi")
@dataclass(frozen=True)
class RegionsOfInterest(Facing):
    """Propose views that face the frontier, or surface with low confidence ([active_gs, code]).

    A cell has low confidence if it contains more than 5 Gaussians of confidence below 0.3 and opacity above 0.7, and it
    or one of its six neighbours is empty. Its normal is the mean normal of these Gaussians. A view must see its region;
    the original does not test this.
    """

    def regions(self, context: SourceContext) -> tuple[np.ndarray, np.ndarray]:
        """Return the cells that are frontier or have low confidence, and the mean normals of the latter."""
        gaussians, volume = context.mapper.map, context.volume
        frontier, seen = frontier_cells(volume), view_directions(context.mapper)
        doubtful = np.flatnonzero((gaussian_confidence(seen) < 0.3) & (gaussians.opacities > 0.7))
        inside = volume.voxel_of(gaussians.means[doubtful]) // SIDE
        kept = ((inside >= 0) & (inside < np.array(frontier.shape))).all(axis=1)
        at = tuple(inside[kept].T)
        count, normals = np.zeros(frontier.shape, dtype=np.int64), np.zeros((*frontier.shape, 3))
        np.add.at(count, at, 1)
        np.add.at(normals, at, seen.normals[doubtful[kept]])
        unsure = (count > 5) & ndimage.binary_dilation(empty_cells(volume))
        cells = np.argwhere(frontier | unsure)
        return cells, np.where(unsure[..., None], normals, 0.0)[tuple(cells.T)]
