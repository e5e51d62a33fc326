"""The walk and the held-out views behind the mapping benchmarks, and what is measured on them."""

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera, look_along, rotation_angle
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.mapping import Mapper, MapperConfig
from activestructure_gym.scenes.library import load_scene
from benchmarks.growth import (
    gaussians_in_view,
    growth_steps,
    resident_mb,
    run_growth_benchmark,
)
from benchmarks.mapping import RECIPES, Recipe, make_course, map_course
from benchmarks.mapping_views import (
    capture,
    held_out_poses,
    observed_share,
    random_walk,
    true_volume,
)

CAMERA = PinholeCamera.from_size(64, 36)


@pytest.fixture(scope="module")
def scene():
    return load_scene("box", size=(5.0, 4.0, 2.5))


@pytest.fixture(scope="module")
def course(scene):
    return make_course(scene, keyframes=12, views=4, size=(64, 36), seed=3)


def test_the_walk_moves_as_an_agent_does_and_keeps_clear(scene):
    volume = true_volume(scene)
    start = ground_truth_of(scene).free_space.start_poses[0]
    walk = random_walk(volume, start, 150, np.random.default_rng(0))
    assert walk.shape == (150, 4, 4) and np.array_equal(walk[0], start)
    steps = np.linalg.norm(np.diff(walk[:, :3, 3], axis=0), axis=1)
    turns = [rotation_angle(a, b) for a, b in zip(walk[:-1], walk[1:])]
    assert steps.max() <= 0.1 + 1e-9 and np.degrees(max(turns)) <= 10.0 + 1e-6
    assert steps.sum() > 3.0
    assert ground_truth_of(scene).free_space.clearance_at(walk[1:, :3, 3]).min() > 0.1
    assert np.array_equal(walk, random_walk(volume, start, 150, np.random.default_rng(0)))
    assert not np.array_equal(walk, random_walk(volume, start, 150, np.random.default_rng(1)))


def test_a_walk_stays_where_its_goals_are_and_says_when_there_are_none(scene):
    volume, start = true_volume(scene), ground_truth_of(scene).free_space.start_poses[0]
    near = random_walk(
        volume,
        start,
        120,
        np.random.default_rng(0),
        goal_allowed=lambda p: np.linalg.norm(p - start[:3, 3], axis=1) < 0.8,
    )
    assert np.linalg.norm(near[:, :3, 3] - start[:3, 3], axis=1).max() < 0.9
    with pytest.raises(InputError, match="no place to go"):
        random_walk(volume, start, 20, np.random.default_rng(0), goal_allowed=lambda p: np.zeros(len(p), bool))


def test_observed_means_measured_there_and_from_nearly_as_close():
    """A keyframe looks along x at a wall 2 m away; it sees 2 m to each side of the axis there."""
    pose = look_along(np.zeros(3), np.array([1.0, 0.0, 0.0]))
    wall = Frame(np.zeros((36, 64, 3), np.uint8), np.full((36, 64), 2.0, np.float32), pose, CAMERA)
    on_wall, beside, behind, before = [2.0, 0.5, 0.2], [2.0, 2.2, 0.0], [2.2, 0.0, 0.0], [1.8, 0.0, 0.0]
    for point, expected in ((on_wall, 1.0), (beside, 0.0), (behind, 0.0), (before, 0.0), ([-2.0, 0.0, 0.0], 0.0)):
        assert observed_share(np.array([point]), np.array([2.0]), [wall]) == expected
    # The keyframe's 2 m are at most 1.5 times the view's distance from 1.33 m on.
    depths = np.array([1.3, 1.4, 5.0])
    assert observed_share(np.array([on_wall] * 3), depths, [wall]) == pytest.approx(2 / 3)
    assert observed_share(np.array([on_wall, beside]), np.array([2.0, 2.0]), [wall, wall]) == 0.5
    assert observed_share(np.array([on_wall]), np.array([2.0]), []) == 0.0


def test_held_out_views_look_at_what_was_seen(scene, course):
    shares = [
        observed_share(view.world_points(), view.depth[view.depth > 0], course.keyframes) for view in course.truth
    ]
    assert min(shares) > 0.8  # chosen by .9 of a fifth of the pixels per axis
    for view in course.truth:
        assert min(np.abs(view.world_from_camera - frame.world_from_camera).max() for frame in course.keyframes) > 0.01
    with pytest.raises(InputError, match="held-out views"):
        held_out_poses(scene, CAMERA, course.keyframes[:1], 2, np.random.default_rng(0), least_observed=1.0, tries=20)


def test_a_course_depends_on_its_seed_alone(scene, course):
    again, other = (make_course(scene, keyframes=12, views=4, size=(64, 36), seed=seed) for seed in (3, 4))
    for one, two in zip(course.keyframes + course.truth, again.keyframes + again.truth):
        assert np.array_equal(one.rgb, two.rgb) and np.array_equal(one.depth, two.depth)
    assert not np.array_equal(course.keyframes[5].depth, other.keyframes[5].depth)


def test_mapping_the_course_shows_it(course):
    mapped = map_course(course, Recipe("default", 5), scene="box")
    errors = [
        np.median(np.abs(shown - frame.depth)[frame.depth > 0]) for shown, frame in zip(mapped.depth, course.truth)
    ]
    assert np.median(errors) < 0.1
    assert mapped.color.shape == (4, 36, 64, 3) and 0 <= mapped.color.min() and mapped.color.max() <= 1
    assert mapped.gaussians > 300 and mapped.event_seconds > 0
    truth = np.stack([frame.rgb for frame in course.truth]) / 255.0
    assert np.mean((mapped.color - truth) ** 2) < 0.02  # measured .011, on walls half seen at this size
    assert not np.array_equal(mapped.color, map_course(course, Recipe("splatam", 5), scene="box").color)


def test_recipes_are_what_they_say():
    for recipe in RECIPES:
        config = recipe.make(np.random.default_rng(0)).config
        assert (config.name, config.iterations) == (recipe.mapper, recipe.iterations)
    assert str(RECIPES[-1]) == "splatam at 15"


def test_gaussians_in_view_are_those_that_project_into_the_image():
    pose = look_along(np.zeros(3), np.array([1.0, 0.0, 0.0]))
    frame = Frame(np.zeros((36, 64, 3), np.uint8), np.ones((36, 64), np.float32), pose, CAMERA)
    parameters = np.zeros((14, 6), np.float32)
    # In front; behind the camera; beyond the left and right border; hidden but inside; above the image.
    parameters[:3] = np.array([[1, 0, 0], [-1, 0, 0], [1, 1.1, 0], [1, -1.1, 0], [9, 2, 1], [1, 0, 0.7]]).T
    assert gaussians_in_view(parameters, frame) == 2


def test_what_is_seen_of_the_first_place_does_not_change_while_the_map_grows(scene):
    calls = []
    rows, pair = run_growth_benchmark(
        scene,
        Mapper(MapperConfig(iterations=1), np.random.default_rng(0)),
        checkpoints=(20, 30),
        pair=(20, 30),
        size=(64, 36),
        scored=4,
        probes=3,
        advance=lambda: calls.append(1),
    )
    assert len(calls) == growth_steps((20, 30))
    small, large = rows
    assert (small.keyframes, large.keyframes) == pair.keyframes == (20, 30)
    assert large.gaussians > 1.2 * small.gaussians
    # Global visits prune one or the other.
    assert abs(large.in_view - small.in_view) <= 0.02 * small.in_view
    assert (small.gaussians, large.gaussians) == pair.gaussians and (small.in_view, large.in_view) == pair.in_view
    assert pair.pairs == 9 and 0 < pair.event_ratio[0] <= pair.event_ratio[1] <= pair.event_ratio[2]
    assert 0 < pair.decision_ratio[0] <= pair.decision_ratio[1] <= pair.decision_ratio[2]
    assert resident_mb() > 50


def test_captured_frames_are_what_the_camera_sees(scene):
    pose = look_along(np.array([2.5, 2.0, 1.2]), np.array([1.0, 0.0, 0.0]))
    calls = []
    (frame,) = capture(scene, CAMERA, pose[None], supersample=1, advance=lambda: calls.append(1))
    assert frame.depth[18, 32] == pytest.approx(2.5, abs=1e-3) and len(calls) == 1
    (cut,) = capture(scene, CAMERA, pose[None], supersample=1, max_range=2.0)
    assert cut.depth[18, 32] == 0.0
