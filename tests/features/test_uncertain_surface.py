"""Uncertainty by perturbation against what one Gaussian does, its proxy by hand, and clusters drawn by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import spearmanr

from activestructure_gym.features import FeatureContext
from activestructure_gym.features.uncertain_surface import (
    PERTURBATIONS,
    STAND_OFF,
    STEP,
    Surface,
    by_perturbing_all,
    by_perturbing_means,
    by_proxy,
    clusters,
    covering_views,
    free_side,
)
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.mapping.gaussian_map import GaussianMap
from activestructure_gym.splatting import cpu
from activestructure_gym.volume import FREE, OCCUPIED, VolumeConfig, VoxelVolume

CAMERA = PinholeCamera.from_size(40, 24)
BOUNDS = np.array([[0.0, 0, 0], [4.0, 4, 3]])
X = np.array([1.0, 0.0, 0.0])


def room() -> VoxelVolume:
    volume = VoxelVolume(BOUNDS, VolumeConfig())
    volume.state[:] = OCCUPIED
    volume.state[1:31, 1:-1, 1:-1] = FREE  # the wall ahead begins at x = 3
    return volume


def wall(points: np.ndarray, sigma: np.ndarray | float, opacity: float = 0.9) -> np.ndarray:
    """Disks at ``points`` [n, 3] that face x."""
    block = np.zeros((14, len(points)), np.float32)
    block[:3], block[3] = points.T, 1.0
    block[7:10] = np.log(np.broadcast_to(sigma, (len(points),)))
    block[7] = np.log(1e-3)
    block[10] = np.log(opacity / (1 - opacity))
    return block


def context(block: np.ndarray, poses: list | None = None, volume: VoxelVolume | None = None) -> FeatureContext:
    gaussians = GaussianMap(16)
    gaussians.append(block)
    mapper = SimpleNamespace(
        map=gaussians,
        keyframes=[],
        rasterizer=cpu,
        render_depth_alpha=lambda camera, poses: cpu.render_depth_alpha(
            gaussians.parameters, gaussians.count, camera, poses
        ),
    )
    poses = [look_along(np.array([1.0, 2.0, 1.5]), X)] if poses is None else poses
    return FeatureContext(
        mapper=mapper, volume=volume or room(), planes=None, camera=CAMERA, bounds=BOUNDS, coverage_alpha=0.5,
        max_range=10.0, world_from_camera=np.stack(poses),
    )  # fmt: skip


def grid(low: float, high: float, step: float) -> np.ndarray:  # [n, 3] on the wall at x = 3.05, within centimetres
    y, z = np.meshgrid(np.arange(low, high, step), np.arange(1.0, 2.0, step), indexing="ij")
    return np.stack([3.05 + 0.02 * np.sin(1e4 * np.arange(y.size)), y.ravel(), z.ravel()], axis=1)


def test_one_gaussian_is_as_uncertain_as_its_offsets_along_the_view() -> None:
    surface = by_perturbing_means(context(wall(np.array([[3.05, 2.0, 1.5]]), 0.25)))
    rng = np.random.default_rng([0, 0])  # seeded by the number of keyframes
    along = [STEP * rng.standard_normal((3, 1), np.float32)[0, 0] for _ in range(PERTURBATIONS)]
    assert len(surface.uncertainty) > 4
    np.testing.assert_allclose(surface.uncertainty, np.abs(along).mean(), rtol=0.02)
    np.testing.assert_allclose(surface.points[:, 0], 3.05, atol=1e-3)
    np.testing.assert_allclose(surface.normals, np.tile(-X, (len(surface.normals), 1)), atol=0.01)


def test_many_gaussians_steady_each_other_and_the_proxy_says_so_too() -> None:
    sparse, dense = grid(1.0, 2.0, 0.12), grid(2.0, 3.0, 0.04)
    ctx = context(np.concatenate([wall(sparse, 0.07, 0.7), wall(dense, 0.07, 0.2)], axis=1))
    means = {}
    for measure in (by_perturbing_means, by_perturbing_all, by_proxy):
        surface = measure(ctx)
        left = surface.points[:, 1] < 2.0
        assert 40 < left.sum() < len(left) - 40
        assert surface.uncertainty[left].mean() > 1.2 * surface.uncertainty[~left].mean()
        means[measure] = dict(zip(map(tuple, surface.voxels.tolist()), surface.uncertainty))
    both = sorted(means[by_perturbing_means].keys() & means[by_proxy].keys())
    assert len(both) > 80
    rank = spearmanr([means[by_perturbing_means][v] for v in both], [means[by_proxy][v] for v in both])[0]
    assert rank > 0.4


def test_perturbing_is_deterministic_and_leaves_the_map_alone() -> None:
    ctx = context(wall(grid(1.0, 3.0, 0.1), 0.08))
    before = ctx.mapper.map.parameters.copy()
    first, second = by_perturbing_all(ctx), by_perturbing_all(ctx)
    np.testing.assert_array_equal(first.uncertainty, second.uncertainty)
    np.testing.assert_array_equal(ctx.mapper.map.parameters, before)
    assert (by_perturbing_means(ctx).uncertainty != first.uncertainty).any()
    ctx.mapper.keyframes.append(None)  # the next decision draws anew, as the original does
    assert (by_perturbing_all(ctx).uncertainty != first.uncertainty).any()


def test_proxy_by_hand() -> None:
    places = np.array([[3.05, 1.05, 1.05]] * 2 + [[3.05, 2.05, 1.05]] * 3 + [[3.05, 2.55, 1.05], [3.05, 2.95, 1.05]])
    block = wall(places, 0.05)
    opacity = np.array([0.6, 0.8, 0.5, 0.5, 0.5, 0.7, 0.4])
    block[10] = np.log(opacity / (1 - opacity))
    surface = by_proxy(context(block))
    # sqrt(.36 + .64) / 1.4, sqrt(.75) / 1.5, 1; the last is too faint to be a surface.
    np.testing.assert_allclose(surface.uncertainty, [1.0 / 1.4, np.sqrt(0.75) / 1.5, 1.0], rtol=1e-5)
    np.testing.assert_allclose(surface.points[:, 1], [1.05, 2.05, 2.55], rtol=1e-5)


def test_gaussians_without_a_free_side_are_no_surface() -> None:
    inside = np.array([[3.65, 2.05, 1.05], [3.05, 2.05, 1.05]])
    assert len(by_proxy(context(wall(inside, 0.05))).points) == 1


def test_the_free_side_of_walls_and_corners() -> None:
    volume = room()
    voxel = volume.voxel_of(np.array([[3.05, 2.0, 1.5], [2.0, 0.0, 1.5], [3.05, 0.0, 1.5], [3.65, 2.0, 1.5]]))
    voxel[1:3, 1] = 0
    normals = free_side(volume, voxel)
    np.testing.assert_allclose(normals[:2], [[-1, 0, 0], [0, 1, 0]], atol=1e-9)
    np.testing.assert_allclose(normals[2], [-np.sqrt(0.5), np.sqrt(0.5), 0], atol=1e-9)
    np.testing.assert_array_equal(normals[3], 0.0)
    volume.state[:] = FREE
    volume.state[20, :, :] = OCCUPIED  # as free on one side as on the other
    np.testing.assert_array_equal(free_side(volume, np.array([[20, 10, 10]])), 0.0)


def test_views_are_chosen_for_what_the_ones_before_do_not_see() -> None:
    block = np.concatenate([wall(grid(0.5, 1.2, 0.05), 0.05), wall(grid(2.8, 3.5, 0.05), 0.05)], axis=1)
    left, right, away = ([1.0, 0.8, 1.5], X), ([1.0, 3.2, 1.5], X), ([1.0, 2.0, 1.5], -X)
    both = ([0.3, 2.0, 1.5], X)
    poses = [look_along(np.array(p), d) for p, d in (left, away, right)]
    assert sorted(covering_views(context(block, poses)).tolist()) == [0, 2]
    poses.append(look_along(np.array(both[0]), both[1]))
    assert covering_views(context(block, poses))[0] == 3
    assert len(covering_views(context(block, poses[1:2]))) == 0
    assert len(by_perturbing_means(context(block, poses[1:2])).points) == 0


def drawn(picture: list[str], size: float = 0.1) -> Surface:
    """A surface in the plane z = 0 with normals up; digits are the uncertainty, points are nothing."""
    voxels = np.array([(i, j, 0) for i, row in enumerate(picture) for j, mark in enumerate(row) if mark != "."])
    values = np.array([float(mark) for row in picture for mark in row if mark != "."])
    return Surface(voxels, voxels * size, np.tile([0.0, 0.0, 1.0], (len(voxels), 1)), values)


def test_clusters_by_hand() -> None:
    surface = drawn([
        "9911111111",
        "9191111111",
        "1111111188",
        "1111111188",
        "1111118111",
    ])  # fmt: skip
    # The 9 most uncertain: the eights and the nines, of which one each stands alone, as a corner joins nothing.
    found = clusters(surface, 9 / 50)
    np.testing.assert_allclose(found.shares, [4 / 50, 3 / 50, 1 / 50, 1 / 50])
    np.testing.assert_allclose(found.centres[1], [0.1 / 3, 0.1 / 3, 0.0])
    np.testing.assert_allclose(found.targets[1], [0.1 / 3, 0.1 / 3, STAND_OFF])
    np.testing.assert_allclose(found.directions[1], [0, 0, -1])


def test_small_pieces_are_no_clusters_and_the_largest_comes_first() -> None:
    rows = ["9" * 160, "9" * 160, "1" * 160, "1" * 160, ("9" + "111" + "99" + "111" + "9" * 77).ljust(160, "1")]
    # 400 of 800 are kept, of which 2 are half a percent: the single one is too small.
    np.testing.assert_allclose(clusters(drawn(rows), 400 / 800).shares, [320 / 800, 77 / 800, 2 / 800])


def test_below_leaves_out_what_is_higher() -> None:
    surface = drawn(["12", "34"])
    surface.points[:, 2] = [0.5, 2.0, 1.0, 3.0]
    low = surface.below(2.0)
    assert low.uncertainty.tolist() == [1.0, 3.0]
    assert low.voxels.tolist() == [[0, 0, 0], [1, 0, 0]]
    assert (len(low.points), len(low.normals)) == (2, 2)


def test_no_surface_no_clusters() -> None:
    empty = Surface(np.zeros((0, 3), np.int64), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    assert len(clusters(empty, 0.2).shares) == 0


@pytest.mark.parametrize(("keep", "large"), [(0.8, True), (0.2, False)])
def test_four_fifths_of_a_room_are_one_cluster_and_its_target_is_the_middle(
    keep: float, large: bool, rng: np.random.Generator
) -> None:
    """The pathology of the rule of ActiveINR: the target says nothing about where the surface is uncertain."""
    volume = VoxelVolume(BOUNDS, VolumeConfig())
    volume.state[:] = OCCUPIED
    volume.state[1:-1, 1:-1, 1:-1] = FREE
    voxels = np.argwhere(volume.state == OCCUPIED)
    normals = free_side(volume, voxels)
    found = clusters(Surface(voxels, volume.center_of(voxels), normals, rng.uniform(0, 1, len(voxels))), keep)
    assert (found.shares.max(initial=0.0) > 0.7) == large
    if large:
        np.testing.assert_allclose(found.targets[0], BOUNDS.mean(axis=0), atol=0.1)
