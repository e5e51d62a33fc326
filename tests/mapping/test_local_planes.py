"""Noisy depth on local planes: laws, an edge, a pixel by numpy's least squares, and what the mapper makes of it."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.depth_noise import axial_sigma
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping import Mapper, MapperConfig
from activestructure_gym.mapping.local_planes import on_local_planes
from activestructure_gym.sensors.noise import noisy_depth

CAMERA = PinholeCamera.from_size(80, 45)


def slanted(at: float, tilt: float) -> np.ndarray:  # [45, 80] metres
    """Depth of a plane that the optical axis meets ``at`` metres, tilted about the image's axes."""
    rays = CAMERA.rays().astype(np.float64)
    return (at / (1.0 + tilt * rays[..., 0] - 0.5 * tilt * rays[..., 1])).astype(np.float32)


@pytest.mark.parametrize("tilt", [0.0, 0.4, 0.9])
@pytest.mark.parametrize("scale", [1e-3, 1.0])
def test_a_plane_without_noise_stays_as_it_is(tilt: float, scale: float) -> None:
    depth = slanted(4.0, tilt)
    np.testing.assert_allclose(on_local_planes(depth, scale), depth, rtol=2e-6)


def floor(height: float) -> np.ndarray:  # [45, 80] metres
    """Depth of a floor so far below a level camera; none above the horizon and beyond 8 m."""
    down = CAMERA.rays()[..., 1].astype(np.float64)
    depth = np.where(down > 0, height / np.maximum(down, 1e-9), 0.0)
    return np.where(depth < 8.0, depth, 0.0).astype(np.float32)


def test_noise_on_a_floor_seen_at_a_slant_shrinks_too() -> None:
    depth = floor(1.4)
    noisy = noisy_depth(depth, CAMERA, np.random.default_rng(1), model="kinect")
    seen = (depth > 0) & (noisy > 0)
    cleaned = on_local_planes(noisy, 1.0)
    before, after = (np.sqrt(np.mean((d - depth)[seen] ** 2)) for d in (noisy, cleaned))
    assert after < 0.75 * before
    assert (cleaned == noisy)[seen].mean() < 0.1


@pytest.mark.parametrize("at", [2.0, 5.0, 8.0])
@pytest.mark.parametrize("tilt", [0.0, 0.5])
def test_noise_on_a_plane_shrinks_by_almost_half_or_more(at: float, tilt: float) -> None:
    depth = slanted(at, tilt)
    noisy = noisy_depth(depth, CAMERA, np.random.default_rng(1), model="kinect")
    before, after = (np.sqrt(np.mean((d - depth) ** 2)) for d in (noisy, on_local_planes(noisy, 1.0)))
    assert after < 0.55 * before


def test_what_was_measured_is_not_written_to_and_no_return_stays_none() -> None:
    depth = noisy_depth(slanted(3.0, 0.3), CAMERA, np.random.default_rng(2), model="kinect")
    depth[10:14, 20:30] = 0.0
    kept = depth.copy()
    cleaned = on_local_planes(depth, 1.0)
    np.testing.assert_array_equal(depth, kept)
    np.testing.assert_array_equal(cleaned == 0.0, depth == 0.0)
    assert cleaned.dtype == np.float32 and np.isfinite(cleaned).all()


def test_both_sides_of_an_edge_stay_where_they_are() -> None:
    depth = np.full((45, 80), 5.0, np.float32)
    depth[:, :40] = 4.0  # 1 m: 24 sigmas
    np.testing.assert_allclose(on_local_planes(depth, 1.0), depth, rtol=1e-6)
    small = depth.copy()
    small[:, :40] = 4.96  # 4 cm, one sigma: nobody can tell the two apart
    assert 4.961 < on_local_planes(small, 1.0)[20, 39] < 4.999


def test_a_pixel_that_shows_nothing_else_around_it_keeps_its_depth() -> None:
    depth = np.full((9, 9), 6.0, np.float32)
    depth[4, 4] = 3.0
    assert on_local_planes(depth, 1.0)[4, 4] == 3.0
    alone = np.zeros((9, 9), np.float32)
    alone[4, 4] = 7.25
    np.testing.assert_array_equal(on_local_planes(alone, 1.0), alone)
    np.testing.assert_array_equal(on_local_planes(np.zeros((3, 4), np.float32), 1.0), 0.0)


def slope(line: np.ndarray, sigma: float) -> float:
    """Slope at the middle of five values of 1 / z, by the three to one side that miss one line by less."""
    sides = [line[2::-1], line[2:]]
    off = [abs(np.diff(side, 2)[0]) if (side > 0).all() else np.inf for side in sides]
    better = int(off[1] < off[0])
    return (2 * better - 1) * (sides[better][2] - line[2]) / 2 if off[better] < 6 * sigma else 0.0


def by_lstsq(depth: np.ndarray, row: int, column: int) -> float:
    """The same by numpy, in float64: the plane of every round from weighted least squares over a list of neighbours."""
    inverse = np.where(depth > 0, 1.0 / np.where(depth > 0, depth, 1.0).astype(np.float64), 0.0)
    sigma = axial_sigma(float(depth[row, column])) / float(depth[row, column]) ** 2
    around = np.pad(inverse, 2)[row : row + 5, column : column + 5]
    flat = np.array([inverse[row, column], 0.0, 0.0])
    steep = np.array([inverse[row, column], slope(around[2], sigma), slope(around[:, 2], sigma)])
    near, (v, u) = around[1:4, 1:4], np.mgrid[-1:2, -1:2]
    weights = [
        np.clip(1 - ((near - start[0] - start[1] * u - start[2] * v) / (3 * sigma)) ** 2, 0, None)[near > 0].sum()
        for start in (flat, steep)
    ]
    fit = steep if weights[1] > weights[0] else flat
    for reach in (1, 2, 2):
        rows, columns = np.mgrid[row - reach : row + reach + 1, column - reach : column + reach + 1].reshape(2, -1)
        inside = (rows >= 0) & (columns >= 0) & (rows < depth.shape[0]) & (columns < depth.shape[1])
        rows, columns = rows[inside], columns[inside]
        value = inverse[rows, columns]
        design = np.stack([np.ones(len(rows)), columns - column, rows - row], axis=1)
        weight = np.where(value > 0, np.clip(1.0 - ((value - design @ fit) / (3.0 * sigma)) ** 2, 0.0, None), 0.0)
        root = np.sqrt(weight)
        fit = np.linalg.lstsq(design * root[:, None], value * root, rcond=None)[0]
    return float(1.0 / fit[0])


def test_agrees_with_numpys_least_squares() -> None:
    depth = noisy_depth(slanted(5.0, 0.6), CAMERA, np.random.default_rng(3), model="kinect")
    depth[20:23, 50:53] = 0.0
    cleaned = on_local_planes(depth, 1.0)
    for row, column in ((0, 0), (22, 40), (44, 79), (19, 51), (30, 7), (0, 33), (21, 49), (12, 78)):
        assert cleaned[row, column] == pytest.approx(by_lstsq(depth, row, column), rel=1e-6)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (5, 1), (2, 2), (0, 0)])
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1000.0])
def test_small_images_and_any_noise_give_finite_depths(shape: tuple[int, int], scale: float) -> None:
    depth = np.random.default_rng(6).uniform(0.5, 9.0, shape).astype(np.float32)
    cleaned = on_local_planes(depth, scale)
    assert cleaned.shape == shape and np.isfinite(cleaned).all() and (cleaned > 0).all()


def test_a_larger_scale_takes_more_for_one_plane() -> None:
    depth = np.full((45, 80), 5.0, np.float32)
    depth[:, :40] = 4.8  # 5 sigmas of the first, 1 of the second
    assert np.array_equal(on_local_planes(depth, 1.0)[20, 38:42] > 4.9, [False, False, True, True])
    assert np.ptp(on_local_planes(depth, 5.0)[20, 38:42]) < 0.15


def walls(scale: float) -> Mapper:
    """The map of a far wall that was measured ten times, by a mapper that expects so much noise."""
    mapper = Mapper(MapperConfig(depth_noise_scale=scale, iterations=0), np.random.default_rng(0))
    depth, rng = slanted(7.0, 0.1), np.random.default_rng(4)
    for _ in range(10):
        noisy = noisy_depth(depth, CAMERA, rng, model="kinect")
        mapper.observe(Frame(np.full((45, 80, 3), 128, np.uint8), noisy, np.eye(4), CAMERA))
    return mapper


def test_a_far_wall_is_nearer_to_where_it_is() -> None:
    off = []
    for mapper in (walls(0.0), walls(1.0)):
        means = mapper.map.means
        ray = means[:, :2] / means[:, 2:]
        off.append(np.abs(means[:, 2] - 7.0 / (1.0 + 0.1 * ray[:, 0] - 0.05 * ray[:, 1])))
    assert np.mean(off[1]) < 0.5 * np.mean(off[0])


def test_by_splatams_rule_depth_is_taken_as_measured() -> None:
    noisy = noisy_depth(slanted(6.0, 0.2), CAMERA, np.random.default_rng(5), model="kinect")
    frame = Frame(np.full((45, 80, 3), 128, np.uint8), noisy, np.eye(4), CAMERA)
    maps = []
    for scale in (0.0, 1.0):
        mapper = Mapper(
            MapperConfig(seed_spacing=None, depth_noise_scale=scale, iterations=0), np.random.default_rng(0)
        )
        mapper.observe(frame)
        maps.append(mapper.map.parameters[:, : mapper.map.count])
    np.testing.assert_array_equal(*maps)
