"""The tangent grid: cells stay with the plane, nothing falls between cells when grids are joined."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from activestructure_gym.planes.surface import Patch, SurfaceGrid, disc


def patch(low, mask):
    mask = np.asarray(mask, dtype=np.int32)
    return Patch(np.asarray(low, dtype=np.int64), mask, np.zeros_like(mask), mask, np.zeros(mask.shape, np.uint8))


def square(axes=None, origin=(0.0, 0.0, 0.0), cells=20):
    grid = SurfaceGrid(np.asarray(origin), np.eye(3) if axes is None else axes, 0.05)
    grid.add(patch((0, 0), np.ones((cells, cells))))
    return grid


def test_area_centroid_and_points_by_hand():
    grid = SurfaceGrid(np.array([1.0, 2.0, 3.0]), np.eye(3), 0.05)
    grid.add(patch((-1, 4), [[1, 1, 0], [1, 0, 0]]))
    assert grid.area == pytest.approx(3 * 0.0025)
    # Cells (-1, 4), (-1, 5), (0, 4): centres at (-0.025, 0.225), (-0.025, 0.275), (0.025, 0.225).
    np.testing.assert_allclose(grid.points(), [[0.975, 2.225, 3], [0.975, 2.275, 3], [1.025, 2.225, 3]])
    np.testing.assert_allclose(grid.centroid, [1 - 0.025 / 3, 2 + 0.725 / 3, 3])


def test_growing_keeps_every_cell(rng):
    grid = SurfaceGrid(np.zeros(3), np.eye(3), 0.05)
    cells = set()
    for _ in range(30):
        low = rng.integers(-100, 100, 2)
        mask = rng.uniform(size=rng.integers(1, 20, 2)) < 0.5
        grid.add(patch(low, mask))
        cells |= {(low[0] + r, low[1] + c) for r, c in np.argwhere(mask)}
    assert {tuple(cell) for cell in np.argwhere(grid.seen) + grid.low} == cells


def test_a_cell_is_outvoted():
    """Shown as often as something else it stays, more often it goes; shown again, it is back."""
    grid = square(cells=3)
    none = np.zeros((1, 1), np.int32)
    denial = Patch(np.array([1, 1]), none, none + 1, none, none.astype(np.uint8) + 1)
    grid.add(denial)
    assert grid.area == pytest.approx(9 * 0.0025)
    grid.add(denial)
    assert grid.area == pytest.approx(8 * 0.0025)
    grid.add(patch((1, 1), [[1]]))
    assert grid.area == pytest.approx(9 * 0.0025)


def test_joining_a_turned_grid_leaves_no_gaps():
    turned = Rotation.from_euler("z", 33.0, degrees=True).as_matrix().T
    grid = square(cells=4)
    other = square(axes=turned, origin=(0.3, -0.2, 0.0), cells=40)
    expected = other.points()
    grid.absorb(other)
    assert grid.area == pytest.approx(4.0 + 0.04, rel=0.02)
    # Every cell of the 2 x 2 m square but those on its rim has its place.
    inner = expected[np.abs((expected - [0.3, -0.2, 0.0]) @ turned[:2].T - 1.0).max(axis=1) < 0.94]
    assert grid.contains(inner).all()


def test_seating_moves_cells_rigidly(rng):
    grid = square(origin=(1.0, 1.0, 0.0))
    before = grid.points()
    normal = np.array([0.1, -0.05, 1.0]) / np.linalg.norm([0.1, -0.05, 1.0])
    grid.seat(normal, -0.3)
    after = grid.points()
    np.testing.assert_allclose(after @ normal - 0.3, 0.0, atol=1e-12)
    np.testing.assert_allclose(grid.axes @ grid.axes.T, np.eye(3), atol=1e-12)
    first, second = rng.integers(0, len(before), (2, 50))
    np.testing.assert_allclose(
        np.linalg.norm(after[first] - after[second], axis=1), np.linalg.norm(before[first] - before[second], axis=1)
    )


def test_contains_with_reach():
    grid = square(cells=4)  # 0 .. 0.2 m
    points = np.array([[0.1, 0.1, 5.0], [0.22, 0.1, 0.0], [0.4, 0.1, 0.0], [-3.0, 0.0, 0.0]])
    assert grid.contains(points).tolist() == [True, False, False, False]
    assert grid.contains(points, reach=1).tolist() == [True, True, False, False]
    assert grid.contains(points, reach=5).tolist() == [True, True, True, False]
    assert not SurfaceGrid(np.zeros(3), np.eye(3), 0.05).contains(points).any()


def test_fewer_points_are_spread_over_all():
    grid = square(cells=40)
    points = grid.points(50)
    assert len(points) == 50
    assert (np.ptp(points, axis=0)[:2] > 1.5).all()


def test_near_a_seen_cell_is_what_a_dilated_mask_holds():
    rng = np.random.default_rng(0)
    grid = SurfaceGrid(np.array([1.0, 2.0, 3.0]), np.eye(3)[[1, 2, 0]], 0.05)
    grid.add(patch((-3, 4), rng.random((12, 20)) < 0.05))
    cells = rng.integers([-10, -3], [16, 31], (400, 2))
    points = grid.origin + (cells + rng.uniform(0.1, 0.9, (400, 2))) * 0.05 @ grid.axes[:2]
    for reach in (0, 1, 3):
        mask = cv2.dilate(np.pad(grid.seen, 20), disc(reach))
        index = cells - grid.low + 20
        np.testing.assert_array_equal(grid.contains(points, reach=reach), mask[index[:, 0], index[:, 1]] > 0)
