"""ActiveGS's regions of interest on a map with Gaussians that are doubted by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from activestructure_gym.mapping.gaussian_map import OPACITY_LOGIT
from activestructure_gym.policies.active_gs import sources as roi
from activestructure_gym.policies.active_gs.sources import RegionsOfInterest
from activestructure_gym.sources.facing import FrontierFacing, empty_cells, frontier_cells
from activestructure_gym.volume import FREE, OCCUPIED, VoxelVolume
from tests.sources.test_sources import TURNS, look_round


def test_regions_of_interest_are_the_frontier_and_known_surface_that_is_doubtful(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run = look_round((TURNS, "roi"))
    gaussians, volume = run.mapper.map, run.volume
    frontier, empty = frontier_cells(volume), np.pad(empty_cells(volume), 1)
    cells = volume.voxel_of(gaussians.means) // 2
    known = [
        cell
        for cell in np.unique(cells, axis=0)
        if (cell < frontier.shape).all() and not frontier[tuple(cell)]
        and any(empty[tuple(cell + 1 + side)] for side in (*np.eye(3, dtype=int), *-np.eye(3, dtype=int)))
    ]  # fmt: skip
    doubted, few = known[len(known) // 2], known[0]
    rows = np.flatnonzero((cells != few).any(axis=1))[:11]
    places = volume.origin + (np.array([doubted] * 6 + [few] * 5) + 0.5) * 2 * volume.voxel_size
    gaussians.parameters[:3, rows] = places.T
    gaussians.parameters[OPACITY_LOGIT, rows] = 3.0  # a logit: .95
    confidence = np.ones(gaussians.count)
    confidence[rows] = 0.29
    monkeypatch.setattr(roi, "gaussian_confidence", lambda seen: confidence)
    context: Any = SimpleNamespace(volume=volume, mapper=run.mapper)
    found, frontiers = (
        {tuple(cell) for cell in kind().regions(context)[0]} for kind in (RegionsOfInterest, FrontierFacing)
    )
    assert found - frontiers == {tuple(doubted)} and found >= frontiers  # of five Gaussians alone nothing is made


@pytest.mark.parametrize(
    ("normal", "expected"), [((0.0, 0.0, 1.0), (0, 0, 1)), ((0.0, 0.0, 0.0), (0.5**0.5, 0, 0.5**0.5))]
)
def test_surface_faces_where_its_gaussians_do(
    monkeypatch: pytest.MonkeyPatch, normal: tuple[float, ...], expected: tuple[float, ...]
) -> None:
    """At the edge of a table, a view from (-0.6, 0, 0.8) is within 60 degrees of its top."""
    volume = VoxelVolume(np.array([[-1.0] * 3, [1.0] * 3]))
    volume.state[:] = FREE
    volume.state[:10, :, :10] = OCCUPIED
    edge = volume.origin + (np.array([4, 5, 4]) + 0.5) * 2 * volume.voxel_size
    doubted = SimpleNamespace(means=np.tile(edge, (6, 1)), opacities=np.full(6, 0.9))
    monkeypatch.setattr(roi, "view_directions", lambda mapper: SimpleNamespace(normals=np.tile(normal, (6, 1))))
    monkeypatch.setattr(roi, "gaussian_confidence", lambda seen: np.zeros(6))
    here = SimpleNamespace(pose=np.eye(4))
    context: Any = SimpleNamespace(volume=volume, mapper=SimpleNamespace(map=doubted), agent=here)
    centres, normals = RegionsOfInterest().foremost(context)
    np.testing.assert_allclose(centres, edge[None])
    np.testing.assert_allclose(normals, [expected], atol=1e-12)
    accepted = normals[0] @ [-0.6, 0.0, 0.8] >= 0.5
    assert accepted == any(normal)
