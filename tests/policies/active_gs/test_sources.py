"""ActiveGS's regions of interest on a map with Gaussians that are doubted by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from activestructure_gym.mapping.gaussian_map import OPACITY_LOGIT
from activestructure_gym.policies.active_gs import sources as roi
from activestructure_gym.policies.active_gs.sources import RegionsOfInterest
from activestructure_gym.sources.facing import FrontierFacing, frontier_cells
from tests.sources.test_sources import TURNS, look_round


def test_regions_of_interest_are_the_frontier_and_known_surface_that_is_doubtful(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run = look_round((TURNS, "roi"))
    gaussians, volume = run.mapper.map, run.volume
    frontier = frontier_cells(volume)
    cells = volume.voxel_of(gaussians.means) // 2
    known = [cell for cell in np.unique(cells, axis=0) if (cell < frontier.shape).all() and not frontier[tuple(cell)]]
    doubted, few = known[len(known) // 2], known[0]
    rows = np.flatnonzero((cells != few).any(axis=1))[:11]
    places = volume.origin + (np.array([doubted] * 6 + [few] * 5) + 0.5) * 2 * volume.voxel_size
    gaussians.parameters[:3, rows] = places.T
    gaussians.parameters[OPACITY_LOGIT, rows] = 3.0  # a logit: .95
    confidence = np.ones(gaussians.count)
    confidence[rows] = 0.29
    monkeypatch.setattr(roi, "gaussian_confidence", lambda seen: confidence)
    context = SimpleNamespace(volume=volume, mapper=run.mapper)
    more = RegionsOfInterest().regions(context) & ~FrontierFacing().regions(context)  # type: ignore[arg-type]
    np.testing.assert_array_equal(np.argwhere(more), [doubted])  # of five Gaussians alone nothing is made
    assert (RegionsOfInterest().regions(context) >= frontier).all()  # type: ignore[arg-type]
