"""Coverage of viewing directions: of single Gaussians by hand, of a wall by pictures."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features import FeatureContext, evaluate_features
from activestructure_gym.features.view_directions import DIRECTIONS
from activestructure_gym.geometry import PinholeCamera, fibonacci_directions, look_along
from activestructure_gym.mapping import Mapper, MapperConfig
from activestructure_gym.mapping.gaussian_map import GaussianMap
from activestructure_gym.policies.view_angle.features import cover
from activestructure_gym.sensors import Frame

CAMERA = PinholeCamera.from_size(64, 36, 60.0)


def test_coverage_by_hand() -> None:
    directions = fibonacci_directions(DIRECTIONS)
    gaussians, bins = GaussianMap(), np.zeros((4, 2), np.uint64)
    gaussians.append(np.zeros((14, 4), np.float32))  # all at the origin
    bins[1, 0] = 1 << 5
    bins[2, 1] = 1 << (100 - 64)
    bins[3] = [1 << 5, 1 << (100 - 64)]
    eye, coverage = 3.0 * directions[100], np.full(4, 7.0, np.float32)
    cover(gaussians.parameters, 4, np.ones(1, bool), eye, bins, directions, coverage)
    far = 0.5 * (directions[5] @ directions[100] + 1.0)
    np.testing.assert_allclose(coverage, [0.0, far, 1.0, 1.0], atol=1e-6)
    cover(gaussians.parameters, 4, np.zeros(1, bool), -eye, bins, directions, coverage)  # the block is out of view
    np.testing.assert_allclose(coverage, [0.0, far, 1.0, 1.0], atol=1e-6)


def test_the_newest_side_of_a_wall_and_last_what_is_not_mapped_at_all() -> None:
    rgb = np.random.default_rng(1).integers(60, 200, (36, 64, 3)).astype(np.uint8)
    mapper = Mapper(MapperConfig(iterations=20), np.random.default_rng(0))
    straight = look_along(np.zeros(3), np.array([1.0, 0.0, 0.0]))
    mapper.observe(Frame(rgb, np.full((36, 64), 2.0, np.float32), straight, CAMERA))
    middle = np.array([2.0, 0.0, 0.0])
    poses = []
    for degrees in (0.0, 35.0, 70.0):
        direction = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0.0])
        poses.append(look_along(middle - 0.6 * direction, direction))  # so near that the wall fills the image
    poses.append(look_along(np.zeros(3), np.array([-1.0, 0.0, 0.0])))
    step = FeatureContext(
        mapper=mapper, volume=None, planes=None, camera=CAMERA.resized(32, 18), bounds=np.zeros((2, 3)),
        coverage_alpha=0.5, max_range=10.0, world_from_camera=np.stack(poses),
    )  # fmt: skip
    same, turned, steep, nothing = evaluate_features(("view_angle",), step)[:, 0]
    assert nothing == 0.0 < same < turned < steep
    # Of what is mapped: straight on it is known up to the bin and the wider fan of so near a camera, and under an angle
    # of theta beyond that it is covered by (1 + cos theta) / 2.
    mapped = (step.alpha[:3] > 0.0).mean(axis=(1, 2))
    covered = (1.0 - np.array([same, turned, steep])) * mapped / step.alpha[:3].mean(axis=(1, 2))
    np.testing.assert_allclose(covered, 0.5 * (1 + np.cos(np.radians([0, 35, 70]))), atol=0.08)


def test_pixels_without_a_map_do_not_make_a_view_better() -> None:
    """From farther away the wall is a part of the image, seen from the side that the keyframe saw."""
    mapper = Mapper(MapperConfig(iterations=20), np.random.default_rng(0))
    straight = look_along(np.zeros(3), np.array([1.0, 0.0, 0.0]))
    rgb = np.full((36, 64, 3), 128, np.uint8)
    mapper.observe(Frame(rgb, np.full((36, 64), 2.0, np.float32), straight, CAMERA))
    far = look_along(np.array([-4.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    step = FeatureContext(
        mapper=mapper, volume=None, planes=None, camera=CAMERA.resized(32, 18), bounds=np.zeros((2, 3)),
        coverage_alpha=0.5, max_range=10.0, world_from_camera=far[None],
    )  # fmt: skip
    assert (step.alpha == 0.0).mean() > 0.5
    assert evaluate_features(("view_angle",), step)[0, 0] < 0.2
