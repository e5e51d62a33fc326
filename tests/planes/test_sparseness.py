"""Which parts of a wall count as too coarsely mapped, with Gaussians laid out by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from activestructure_gym.planes import MapPoints
from activestructure_gym.planes.sparseness import SparsePatches, sparse_patches
from activestructure_gym.planes.surface import SurfaceGrid

CELL = 0.05  # metres
ROWS, COLUMNS = 40, 20  # a wall of 2 m x 1 m
MAX_DISTANCE_M = 0.04  # metres
FAR_AWAY = np.array([[9.0, 9.0, 9.0]])


def wall(at: float = 1.0) -> SimpleNamespace:
    """The plane x = ``at``, seen for y in 0..2 and z in 0..1."""
    grid = SurfaceGrid(np.array([at, 0.0, 0.0]), np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]), CELL)
    grid.seen = np.ones((ROWS, COLUMNS), np.uint8)
    return SimpleNamespace(surface=grid)


def on_cells(at: float = 1.0) -> np.ndarray:  # [N, 3] one point per cell of `wall`
    y, z = np.meshgrid((np.arange(ROWS) + 0.5) * CELL, (np.arange(COLUMNS) + 0.5) * CELL, indexing="ij")
    return np.stack([np.full(y.size, at), y.ravel(), z.ravel()], axis=1)


def patches(nodes: list, means: np.ndarray, sizes: np.ndarray | float, least_cells: int = 20) -> SparsePatches:
    points = MapPoints(means, np.broadcast_to(np.asarray(sizes, float), len(means)).copy())
    return sparse_patches(nodes, points, tile=10, least_cells=least_cells, largest=MAX_DISTANCE_M)


def test_a_wall_with_fine_gaussians_has_no_patch() -> None:
    assert len(patches([wall()], on_cells(), 0.03).centres) == 0


def test_a_wall_with_coarse_gaussians_is_all_patches() -> None:
    found = patches([wall()], on_cells(), 0.1)
    assert len(found.centres) == 8  # tiles of 0.5 m
    np.testing.assert_allclose(found.areas.sum(), 2.0)
    np.testing.assert_allclose(found.sizes, 0.1, rtol=1e-6)
    expected = {(1.0, y, z) for y in (0.25, 0.75, 1.25, 1.75) for z in (0.25, 0.75)}
    assert {tuple(np.round(c, 6)) for c in found.centres} == expected


def test_a_wall_without_gaussians_is_all_patches_beside_one_that_is_fine() -> None:
    found = patches([wall(3.0), wall()], np.concatenate([on_cells(3.0), FAR_AWAY]), 0.03)
    np.testing.assert_array_equal(found.planes, [1] * 8)
    np.testing.assert_allclose(found.areas.sum(), 2.0)
    np.testing.assert_allclose(found.centres[:, 0], 1.0)
    assert (found.sizes > MAX_DISTANCE_M).all()


def test_only_the_bare_half_of_a_wall_is_sparse() -> None:
    points = on_cells()
    found = patches([wall()], np.concatenate([points[points[:, 1] < 1.0], FAR_AWAY]), 0.03)
    # Cells beside the edge have a Gaussian within about a cell.
    assert 0.85 < found.areas.sum() < 1.0
    assert (found.centres[:, 1] > 1.0).all()


def test_the_finest_gaussian_near_counts_in_either_order() -> None:
    both = np.concatenate([on_cells(), on_cells()])
    sizes = np.repeat([0.1, 0.03], len(both) // 2)
    assert len(patches([wall()], both, sizes).centres) == 0
    assert len(patches([wall()], both, sizes[::-1]).centres) == 0
    coarse = np.repeat([0.2, 0.1], len(both) // 2)
    np.testing.assert_allclose(patches([wall()], both, coarse).sizes, 0.1, rtol=1e-6)


def test_the_size_of_a_patch_is_that_of_its_coarse_and_bare_cells() -> None:
    points = on_cells()
    fine, coarse = points[points[:, 1] < 0.2], points[(points[:, 1] > 0.2) & (points[:, 1] < 0.4)]
    both = np.concatenate([fine, coarse, FAR_AWAY])
    sizes = np.concatenate([np.full(len(fine), 0.03), np.full(len(coarse), 0.1), np.full(len(FAR_AWAY), 0.03)])
    found = patches([wall()], both, sizes)
    # Of the first half metre three rows of cells are coarse and two bare; what is fine beside them does not count.
    np.testing.assert_allclose(found.areas[0], 50 * CELL**2)
    np.testing.assert_allclose(found.sizes[0], (3 * 0.1 + 2 * 2 * MAX_DISTANCE_M) / 5, rtol=1e-6)


def test_unseen_cells_and_small_remainders_do_not_count() -> None:
    node = wall()
    node.surface.seen[:] = 0
    node.surface.seen[0:4, 0:5] = 1  # 20 cells of the first tile
    node.surface.seen[10:13, 0:5] = 1  # 15 of the next
    found = patches([node], FAR_AWAY, 0.03)
    np.testing.assert_allclose(found.centres, [[1.0, 0.1, 0.125]])
    np.testing.assert_allclose(found.areas, 20 * CELL**2)
    assert len(patches([node], FAR_AWAY, 0.03, least_cells=15).centres) == 2


def test_the_patches_follow_a_grid_that_grew_and_a_turned_plane() -> None:
    node = wall()
    angle = 0.4
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    node.surface.axes = node.surface.axes @ turn.T
    node.surface.origin = turn @ node.surface.origin
    node.surface.low = np.array([-16, -7])
    rows, columns = np.indices((ROWS, COLUMNS)).reshape(2, -1)
    centres = node.surface.cell_centres(rows, columns)
    assert len(patches([node], centres, 0.03).centres) == 0
    found = patches([node], centres, 0.1)
    np.testing.assert_allclose((found.centres - node.surface.origin) @ node.surface.axes[2], 0.0, atol=1e-9)
    np.testing.assert_allclose(found.areas @ found.centres / 2.0, centres.mean(axis=0), atol=1e-6)


def test_a_map_without_gaussians_is_sparse_wherever_a_plane_was_seen() -> None:
    found = patches([wall(3.0), wall()], np.zeros((0, 3)), 0.03)
    np.testing.assert_allclose(found.areas.sum(), 4.0)
    np.testing.assert_array_equal(np.bincount(found.planes), [8, 8])
    np.testing.assert_allclose(found.sizes, 2 * MAX_DISTANCE_M)


def test_no_tile_of_a_large_plane_is_lost() -> None:
    node = wall()
    node.surface.seen = np.ones((700, 700), np.uint8)  # 35 m x 35 m: 4900 tiles
    found = patches([node], FAR_AWAY, 0.03)
    assert len(found.centres) == 4900
    np.testing.assert_allclose(found.areas.sum(), 35.0**2)


def test_a_gaussian_that_strayed_far_off_costs_no_memory() -> None:
    stray = np.array([[1e5, -2e5, 3e5]])
    near = np.concatenate([on_cells(), stray])
    assert len(patches([wall()], near, 0.03, least_cells=1).centres) == 0
    np.testing.assert_allclose(patches([wall()], near, 0.1).areas.sum(), 2.0)


def test_the_size_of_a_gaussian_is_its_middle_deviation(rng: np.random.Generator) -> None:
    means, scales = rng.normal(size=(3, 50)), rng.normal(size=(3, 50))
    points = MapPoints.from_log_scales(means, scales)
    np.testing.assert_array_equal(points.sizes, np.exp(np.median(scales, axis=0)))
    np.testing.assert_array_equal(points.means, means.T)


def test_a_patch_has_at_least_one_cell() -> None:
    means = on_cells()
    found = patches([wall()], means[means[:, 1] > 1.0], 0.03, least_cells=0)
    assert np.isfinite(found.centres).all() and (found.areas > 0).all()
    assert len(found.centres) == len(patches([wall()], means[means[:, 1] > 1.0], 0.03, least_cells=1).centres)


def test_points_stay_when_the_map_goes_on(rng: np.random.Generator) -> None:
    live = rng.normal(size=(3, 5))
    points = MapPoints.from_log_scales(live, rng.normal(size=(3, 5)))
    before = points.means.copy()
    live += 1.0
    assert np.array_equal(points.means, before)


def test_no_planes() -> None:
    assert len(patches([], on_cells(), 0.03).centres) == 0
