"""Density follows the surface: filled wherever it was seen, nothing where it was not, finer where there is texture."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping import Mapper, MapperConfig
from activestructure_gym.mapping.density import (
    HELD,
    SPARED,
    WANTED,
    states_of_samples,
    surface_samples,
    wanted_spacing,
)

CAMERA = PinholeCamera.from_size(64, 36)  # f = 32: a pixel is 12.5 cm wide at 4 m
SPACING = {"plain": 0.045, "pixels": 1.5, "contrast": 0.02}


def _frame(depth, rgb=None, pose=None):
    depth = np.broadcast_to(np.asarray(depth, np.float32), (36, 64)).copy()
    rgb = np.full((36, 64, 3), 128, np.uint8) if rgb is None else rgb
    return Frame(rgb, depth, np.eye(4) if pose is None else pose, CAMERA)


def _mapper(**config):
    return Mapper(MapperConfig(**config), np.random.default_rng(0))


def _checkers(size=4):
    rows, columns = np.indices((36, 64)) // size
    return np.repeat((((rows + columns) % 2) * 200 + 20)[..., None], 3, axis=2).astype(np.uint8)


def _slanted(normal, offset):
    """Plane normal . p = -offset; no return where it would be farther than 5 m."""
    along = -CAMERA.rays() @ (np.array(normal) / np.linalg.norm(normal))
    depth = np.where(along > 0.02, offset / np.maximum(along, 1e-9), 0.0)
    return np.where(depth < 5.0, depth, 0.0)


@pytest.mark.parametrize("distance", [0.7, 2.0, 4.0, 7.0])
@pytest.mark.parametrize("rgb", [None, _checkers()], ids=["plain", "checkers"])
def test_every_point_of_a_seen_wall_has_a_mean_near(distance, rgb):
    mapper = _mapper()
    mapper.observe(_frame(distance, rgb), iterations=0)
    means = mapper.map.means
    half = distance / CAMERA.fx * np.array([63 / 2, 35 / 2])  # to the outermost pixels' centres
    x, y = (np.linspace(-extent, extent, 301) for extent in half)
    wall = np.stack(np.broadcast_arrays(*np.meshgrid(x, y), distance), axis=-1).reshape(-1, 3)
    # Samples have one within the spacing; between them lies at most the diagonal of their cell.
    assert cKDTree(means).query(wall)[0].max() < 1.9 * 0.045
    assert np.quantile(cKDTree(means).query(wall)[0], 0.99) < 0.05
    assert np.abs(means[:, 2] - distance).max() < 1e-5
    area = 4 * half.prod()
    if rgb is None:
        assert len(means) < 1.5 * area / 0.045**2 + 20 * np.sqrt(area) / 0.045


def test_a_slanted_floor_is_filled_between_its_rows():
    frame = _frame(_slanted((0, -1, -0.2), 1.0))
    gaps = np.linalg.norm(np.diff(CAMERA.backproject(frame.depth), axis=0), axis=-1)
    filled = (frame.depth[1:] > 0) & (frame.depth[:-1] > 0) & (gaps < 0.45)
    assert gaps[filled].max() > 0.3  # far apart
    mapper = _mapper()
    mapper.observe(frame, iterations=0)
    points = CAMERA.backproject(frame.depth)
    middles = 0.5 * (points[1:] + points[:-1])[filled]
    assert np.quantile(cKDTree(mapper.map.means).query(middles)[0], 0.9) < 0.05
    normal = np.array([0, -1, -0.2]) / np.linalg.norm([0, -1, -0.2])
    assert np.abs(mapper.map.means @ normal + 1.0).max() < 1e-3


def test_nothing_stands_between_two_surfaces_or_without_a_return():
    depth = np.full((36, 64), 3.0)
    depth[10:26, 20:44] = 1.5  # a box before the wall
    depth[:, 60:] = 0.0
    mapper = _mapper()
    mapper.observe(_frame(depth), iterations=0)
    z = mapper.map.means[:, 2]
    assert np.minimum(np.abs(z - 3.0), np.abs(z - 1.5)).max() < 1e-5 and (z < 2).any() and (z > 2).any()
    u = CAMERA.fx * mapper.map.means[:, 0] / z + CAMERA.cx
    assert u.max() < 60.0


def test_a_second_look_adds_nothing():
    mapper = _mapper()
    for rgb in (None, _checkers()):
        mapper.observe(_frame(3.0, rgb), iterations=0)
        again = mapper.observe(_frame(3.0, rgb), iterations=0)
        assert again.added == 0 and again.replaced == 0 and again.new_share == 0.0


def test_texture_and_edges_get_more():
    counts = []
    for rgb in (None, _checkers()):
        mapper = _mapper()
        counts.append(mapper.observe(_frame(0.3, rgb), iterations=0).added)
    assert counts[1] > 2.5 * counts[0]
    spacing, edges = wanted_spacing(_frame(0.7), **SPACING)
    assert not edges.any() and (spacing == np.float32(0.045)).all()
    depth = np.full((36, 64), 0.7)
    depth[:, 32:] = 0.5
    spacing, edges = wanted_spacing(_frame(depth), **SPACING)
    assert np.flatnonzero(edges[5]).tolist() == [31, 32]
    assert spacing[5, [30, 31, 32, 33]] == pytest.approx([0.045, 1.5 * 0.7 / 32, 1.5 * 0.5 / 32, 0.045])


@pytest.mark.parametrize("direction", [1, -1])
def test_contrast_is_seen_in_both_directions(direction):
    """Brighter to the right, and darker to the right."""
    rgb = np.zeros((36, 64, 3), np.uint8)
    rgb[:, 32:] = 40
    for contrast, expected in ((0.15, [31, 32]), (0.16, [])):  # 40 of 255 are .157
        spacing, _ = wanted_spacing(
            _frame(0.7, np.ascontiguousarray(rgb[:, ::direction])), plain=0.045, pixels=1.0, contrast=contrast
        )
        assert np.flatnonzero(spacing[9] < 0.04).tolist() == expected


def test_both_sides_of_a_thin_panel_are_mapped():
    mapper = _mapper()
    mapper.observe(_frame(2.0), iterations=0)
    there = look_along(np.array([0.0, 0.0, 4.02]), np.array([0.0, 0.0, -1.0]))
    report = mapper.observe(_frame(2.0, pose=there), iterations=0)  # its other side, 2 cm behind
    z = mapper.map.means[:, 2]
    assert np.isclose(z, 2.0, atol=1e-4).sum() == report.count - report.added
    assert report.added > 0.9 * (report.count - report.added) and np.isclose(z, 2.02, atol=1e-4).sum() == report.added


def test_transparent_gaussians_hold_no_place():
    mapper = _mapper()
    first = mapper.observe(_frame(3.0), iterations=0)
    mapper.map.parameters[10, : first.count] = np.where(np.arange(first.count) % 2, 3.0, -0.01)
    assert mapper.observe(_frame(3.0), iterations=0).added > 0.3 * first.added


def test_states_are_what_a_tree_says():
    rng = np.random.default_rng(3)
    depth = 2.0 + np.cumsum(rng.normal(0, 0.002, (36, 64)), axis=1)
    pose = look_along(np.array([1.0, 2.0, 3.0]), np.array([0.3, -0.8, 0.2]))
    frame = _frame(depth, _checkers(9), pose)
    spacing, _ = wanted_spacing(frame, **SPACING)
    samples = surface_samples(frame, spacing)
    points = samples.points.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
    reach = spacing.ravel()[samples.pixels]
    count = 400
    parameters = np.zeros((14, 1024), np.float32)
    parameters[:3, :count] = (points[rng.integers(len(points), size=count)] + rng.normal(0, 0.02, (count, 3))).T
    parameters[3] = 1.0
    parameters[7:10] = -3.0  # balls: they face everywhere
    parameters[10, :count] = rng.choice([-1.0, 2.0], count)
    leaving = rng.random(count) < 0.2
    states = states_of_samples(samples, spacing, parameters, count, frame, leaving=leaving)
    solid = (parameters[10, :count] > 0) & ~leaving
    near = cKDTree(parameters[:3, :count].T[solid]).query(points)[0]
    clear = np.abs(near - reach) > 1e-5  # float32
    assert ((states == HELD) == (near < reach))[clear].all() and (states == HELD).any()
    wanted = points[states == WANTED]
    pairs = cKDTree(wanted).query(wanted, k=2)[0][:, 1]
    assert (pairs > 0.99 * np.minimum(reach[states == WANTED], reach.min())).all()
    spared = states == SPARED
    assert spared.any() and (cKDTree(wanted).query(points[spared])[0] <= reach[spared] + 1e-5).all()


def test_pixels_come_first_and_carry_their_colours():
    depth = np.full((36, 64), 2.0)
    depth[3, 7] = 0.0
    frame = _frame(depth, np.random.default_rng(0).integers(0, 256, (36, 64, 3), dtype=np.uint8))
    samples = surface_samples(frame, wanted_spacing(frame, **SPACING)[0])
    pixels = np.flatnonzero(frame.depth)
    assert np.array_equal(samples.pixels[: len(pixels)], pixels)
    assert samples.colors[: len(pixels)] * 255 == pytest.approx(frame.rgb.reshape(-1, 3)[pixels])
    assert samples.points[: len(pixels)] == pytest.approx(CAMERA.backproject(frame.depth).reshape(-1, 3)[pixels])
    assert len(samples.pixels) > len(pixels) and samples.colors.min() >= 0 and samples.colors.max() <= 1
