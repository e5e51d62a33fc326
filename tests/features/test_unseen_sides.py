"""Surfaces that the map knows from one side only: by hand, against a slow oracle, and after a look from the other."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from activestructure_gym.features import FeatureContext
from activestructure_gym.features.unseen_sides import NEAR, shown_from_behind, unseen_sides
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping import Mapper, MapperConfig

CAMERA = PinholeCamera.from_size(64, 36)
SCORING = PinholeCamera.from_size(32, 18)


def frame_of_wall(distance: float, pose: np.ndarray, half: float = 0.6) -> Frame:
    """A square board of ``2 half`` metres across the axis of ``pose``, with nothing around it."""
    rays = CAMERA.rays()
    inside = (np.abs(rays[..., :2]) * distance <= half).all(axis=-1)
    depth = np.where(inside, np.float32(distance), np.float32(0.0))
    return Frame(np.full((*depth.shape, 3), 120, np.uint8), depth, pose, CAMERA)


FRONT = look_along(np.array([-2.0, 0, 0]), np.array([1.0, 0, 0]))
BEHIND = look_along(np.array([2.0, 0, 0]), np.array([-1.0, 0, 0]))


def mapped(*frames: Frame) -> Mapper:
    mapper = Mapper(MapperConfig(iterations=0), np.random.default_rng(0))
    for frame in frames:
        mapper.observe(frame)
    return mapper


def context(mapper: Mapper, *poses: np.ndarray) -> FeatureContext:
    options: dict[str, Any] = {"volume": None, "planes": None, "bounds": np.array([[-3.0] * 3, [3.0] * 3])}
    return FeatureContext(
        mapper=mapper, camera=SCORING, coverage_alpha=0.5, max_range=10.0, world_from_camera=np.array(poses), **options
    )


def test_a_board_counts_its_area_from_behind_and_nothing_from_the_front() -> None:
    mapper = mapped(frame_of_wall(2.0, FRONT))
    nearer = look_along(np.array([-1.5, 0.1, 0]), np.array([1.0, 0, 0]))
    behind = look_along(np.array([2.5, 0.1, 0]), np.array([-1.0, 0, 0]))
    front, back = unseen_sides(context(mapper, nearer, behind))
    assert front == 0.0
    # 1.44 m^2, give or take its rim, which is as wide as a pixel (8 cm), and foreshortened off the axis.
    assert back == pytest.approx(1.44, rel=0.2)


def test_a_look_at_the_other_side_ends_it() -> None:
    behind = look_along(np.array([2.5, 0.1, 0]), np.array([-1.0, 0, 0]))
    mapper = mapped(frame_of_wall(2.0, FRONT), frame_of_wall(2.0, BEHIND, half=0.7))
    assert unseen_sides(context(mapper, behind))[0] < 0.05


def test_a_view_that_was_a_keyframe_counts_nothing() -> None:
    mapper = mapped(frame_of_wall(2.0, FRONT))
    empty = Frame(np.zeros((36, 64, 3), np.uint8), np.zeros((36, 64), np.float32), BEHIND, CAMERA)
    assert unseen_sides(context(mapper, BEHIND))[0] > 1.0
    mapper.observe(empty)
    assert unseen_sides(context(mapper, BEHIND))[0] == 0.0


def test_balls_face_everybody() -> None:
    mapper = mapped(frame_of_wall(2.0, FRONT))
    mapper.map.parameters[9] = mapper.map.parameters[8]
    mapper.map.touched()
    assert not unseen_sides(context(mapper, BEHIND)).any()


def test_without_candidates_or_map_there_is_nothing() -> None:
    assert unseen_sides(context(mapped(), FRONT)).tolist() == [0.0]
    none = context(mapped(frame_of_wall(2.0, FRONT)))
    assert unseen_sides(FeatureContext(**{**vars(none), "world_from_camera": np.zeros((0, 4, 4))})).shape == (0,)


def test_pixels_agree_with_all_pairs_of_points_and_gaussians() -> None:
    """Random disks, some of them balls and most transparent; every pixel asks for a depth of its own."""
    rng = np.random.default_rng(3)
    mapper = mapped(frame_of_wall(2.0, FRONT))
    gaussians = mapper.map
    count = gaussians.count
    parameters = gaussians.parameters
    parameters[:3, :count] = rng.uniform(-0.2, 0.2, (3, count))
    parameters[3:7, :count] = rng.normal(size=(4, count))
    parameters[7:10, :count] = np.log(rng.uniform(0.01, 0.05, (3, count)))
    parameters[10, :count] = rng.normal(size=count)
    eyes = rng.normal(size=(8, 3))
    eyes /= np.linalg.norm(eyes, axis=1, keepdims=True)
    poses = [look_along(eye, -eye) for eye in eyes]
    rays = SCORING.rays().astype(np.float64)
    depth = rng.uniform(0.8, 1.2, (8, 18, 32)).astype(np.float32)
    depth[:, ::3] = 0.0
    told = context(mapper, *poses)
    found = shown_from_behind(told, rays, depth)
    p, q, r, s = parameters[3:7, :count].astype(np.float64)
    normals = np.stack([2 * (q * s + p * r), 2 * (r * s - p * q), p * p + s * s - q * q - r * r], axis=1)
    means, solid = parameters[:3, :count].T.astype(np.float64), parameters[10, :count] >= 0.0
    disk = parameters[9, :count] < parameters[8, :count]
    for k, pose in enumerate(poses):
        shows_back = disk & (np.einsum("ni,ni->n", normals, pose[:3, 3] - means) <= 0.0)
        points = pose[:3, 3] + depth[k].astype(np.float64)[..., None] * (rays @ pose[:3, :3].T)
        near = (np.linalg.norm(points[..., None, :] - means, axis=-1) <= NEAR) & solid
        expected = (near & shows_back).any(-1) & ~(near & ~shows_back).any(-1) & (depth[k] > 0)
        assert np.array_equal(found[k], expected)
    assert 20 < found.sum() < 1000
