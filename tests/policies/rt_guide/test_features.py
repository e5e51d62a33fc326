"""Which Gaussians count for and against a view, and what a region is worth, by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from activestructure_gym.features import FeatureContext, evaluate_features
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.policies.rt_guide.features import _displacement, viewing_distance
from activestructure_gym.volume import VoxelVolume

CAMERA = PinholeCamera.from_size(40, 24, 90.0)
FEATURES = ("rt_guide", "rt_guide_region", "rt_guide_cuboid")


def context(means: list, moved: list, places: list, directions: list) -> FeatureContext:
    gaussians = SimpleNamespace(means=np.array(means, np.float32).reshape(-1, 3))
    poses = [look_along(np.array(p, float), np.array(d, float)) for p, d in zip(places, directions)]
    known = SimpleNamespace(metres=lambda: np.array(moved, np.float32))
    return FeatureContext(
        mapper=SimpleNamespace(map=gaussians, memory={_displacement: known}),
        volume=VoxelVolume(np.array([[0.1, 0.1, 0.1], [9.9, 4.9, 2.4]])),  # with its margin 10 x 5 x 2.5 m
        planes=None, camera=CAMERA, bounds=np.zeros((2, 3)), coverage_alpha=0.5, max_range=10.0,
        world_from_camera=np.stack(poses),
    )  # fmt: skip


def test_high_ones_in_the_frustum_count_for_and_low_ones_against() -> None:
    # Mean 2.5, standard deviation 2.29: H above 3.65, L below 1.35; the third is neither.
    means = [[5.0, 2.5, 1.0], [5.2, 2.6, 1.0], [5.4, 2.4, 1.0], [3.0, 2.5, 1.0]]
    moved = [0.006, 0.000, 0.004 - 0.0005, 0.0005]
    ahead, back = [1, 0, 0], [-1, 0, 0]
    step = context(means, moved, [[4, 2.5, 1]] * 2 + [[9.5, 2.5, 1]], [ahead, back, back])
    gain = evaluate_features(FEATURES, step)[:, 0]
    # Ahead one of each; behind a low one; from 9.5 m the first two are within 5 m, and the last one is too far.
    np.testing.assert_allclose(gain, [0.0, -0.25, 0.0], atol=1e-7)
    more = context(means, [0.006, 0.006, 0.0, 0.0], [[4, 2.5, 1]], [ahead])
    np.testing.assert_allclose(evaluate_features(FEATURES, more)[:, 0], [(2 - 1) / 4])


def test_a_region_is_worth_the_mean_of_its_gaussians() -> None:
    means = [[1.0, 1.0, 1.0], [2.0, 2.0, 1.0], [6.0, 1.0, 1.0]]
    looked_at = [[0.5, 0.5, 1.0], [2.4, 2.4, 2.0], [2.6, 1.0, 1.0], [5.5, 2.0, 1.0], [5.5, 3.0, 1.0]]
    places = np.array(looked_at) + [viewing_distance(CAMERA), 0.0, 0.0]
    columns = evaluate_features(FEATURES, context(means, [0.001, 0.003, 0.007], places.tolist(), [[-1, 0, 0]] * 5))
    np.testing.assert_allclose(columns[:, 1], [0.002, 0.002, 0.0, 0.007, 0.0], rtol=1e-6)
    cuboids = columns[:, 2]
    assert cuboids[0] == cuboids[1]
    assert len(set(cuboids.tolist())) == 4


def test_a_view_belongs_to_the_region_that_it_looks_at_and_not_to_the_one_it_stands_in() -> None:
    assert viewing_distance(CAMERA) == pytest.approx(1.25 * 20 / 12)  # 20 x 12 pixels to the border, focal length 20
    means, moved, place = [[1.0, 1.0, 1.0], [4.0, 1.0, 1.0], [6.0, 1.0, 1.0]], [0.001, 0.009, 0.004], [3.6, 1.0, 1.0]
    columns = evaluate_features(FEATURES, context(means, moved, [place, place], [[1, 0, 0], [-1, 0, 0]]))
    np.testing.assert_allclose(columns[:, 1], [0.004, 0.001], rtol=1e-6)


@pytest.mark.parametrize("means", [[], [[1.0, 1.0, 1.0]]])
def test_where_nothing_has_moved_nothing_counts(means: list) -> None:
    columns = evaluate_features(FEATURES, context(means, [0.0] * len(means), [[4, 2.5, 1]], [[1, 0, 0]]))
    assert not columns[:, :2].any()
