"""The way to a view before it is chosen, against what an episode then does."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from activestructure_gym import Reconstruction, configure, ground_truth_of, load_scene
from activestructure_gym.geometry import look_along
from activestructure_gym.motion import Agent, MotionConfig, least_frames, path_lengths, plan_path
from activestructure_gym.motion.trajectory import interpolate
from activestructure_gym.volume import FREE, OCCUPIED, VolumeConfig, VoxelVolume

HERE = look_along(np.array([0.55, 0.55, 0.55]), np.array([1.0, 0, 0]))


def open_space() -> VoxelVolume:
    volume = VoxelVolume(np.array([[0.0, 0, 0], [4.0, 2.0, 1.1]]), VolumeConfig())
    volume.state[1:-1, 1:-1, 1:-1] = FREE
    return volume


def agent(volume: VoxelVolume, frames: int = 3, budget: int = 100) -> Agent:
    distances = path_lengths(volume, HERE[:3, 3], min_clearance=0.1)
    motion = MotionConfig(min_clearance=0.1, candidate_clearance=0.1)
    return Agent(HERE, frames, budget, 5, motion, distances, np.random.default_rng(0))


def moved(x: float, direction: tuple[float, float, float] = (1.0, 0, 0)) -> np.ndarray:
    return look_along(HERE[:3, 3] + [x, 0, 0], np.array(direction))


def test_frames_and_keyframes_of_a_straight_way_by_hand() -> None:
    volume = open_space()
    (path,) = agent(volume).paths(volume, [moved(1.2)])
    assert path is not None
    # 12 steps of 0.1 m. Frames 4 to 15: the fifth, the tenth, and the fifteenth, which is also the last.
    assert path.frames == 12
    np.testing.assert_allclose(path.keyframes[:, 0, 3], [0.75, 1.25, 1.75], atol=1e-9)


def test_the_budget_ends_a_way() -> None:
    volume = open_space()
    (path,) = agent(volume, budget=12).paths(volume, [moved(1.2)])
    assert path is not None
    # Frames 4 .. 12: the fifth, the tenth, and the last of the budget.
    assert path.frames == 9
    np.testing.assert_allclose(path.keyframes[:, 0, 3], [0.75, 1.25, 1.45], atol=1e-9)


@pytest.mark.parametrize(("frames", "budget"), [(3, 100), (4, 100), (0, 9), (12, 12)])
def test_keyframes_are_those_of_every_path_alone(frames: int, budget: int) -> None:
    volume = open_space()
    volume.state[12, :14] = OCCUPIED  # most paths lead around it, so the planner draws random numbers
    rng, asked = np.random.default_rng(2), agent(volume, frames, budget)
    places = np.array([[3.45, 0.55, 0.55], [0.95, 1.25, 0.45], [2.05, 0.45, 0.65], [0.55, 0.55, 0.55]])
    goals = [look_along(place, rng.normal(size=3)) for place in (*places, *places)]
    drawn = 0
    for goal, found in zip(goals, asked.paths(volume, goals)):
        generator = copy.deepcopy(asked.rng)
        path = plan_path(volume, HERE[:3, 3], goal[:3, 3], min_clearance=0.1, rng=generator, distances=asked.distances)
        drawn += generator.bit_generator.state != asked.rng.bit_generator.state
        assert path is not None and found is not None
        poses = interpolate(path, HERE, goal, asked.motion)[: budget - frames]
        number = frames + 1 + np.arange(len(poses))
        taken = (number % 5 == 0) | (number == number[-1:])
        assert found.frames == len(poses) and found.keyframes.tobytes() == poses[taken].tobytes()
    assert drawn >= 4


def test_no_way_through_a_wall_and_nothing_is_drawn() -> None:
    volume = open_space()
    volume.state[20] = OCCUPIED
    asked = agent(volume)
    state = asked.rng.bit_generator.state
    behind, before = asked.paths(volume, [moved(2.2), moved(0.5)])
    assert behind is None and before is not None
    assert asked.rng.bit_generator.state == state
    assert np.isinf(asked.least_frames(np.array([moved(2.2)]))).all()


def test_least_frames_by_hand() -> None:
    turned = [np.cos(np.radians(95)), np.sin(np.radians(95)), 0]
    half = [np.cos(np.radians(40)), np.sin(np.radians(40)), 0]
    views = np.stack([HERE, moved(0.35), moved(0.0, tuple(turned)), moved(1.0, tuple(half))])
    # Nothing to do still costs a frame; 3.5 steps; 9.5 turns; 10 steps against 4 turns.
    np.testing.assert_array_equal(
        least_frames(HERE, views, np.array([0, 0.35, 0, 1.0]), MotionConfig()), [1, 4, 10, 10]
    )


@pytest.mark.parametrize("row", [0, 7])
def test_an_episode_goes_the_way_that_was_foretold(row: int) -> None:
    episode = Reconstruction(configure("fast", {"frame_budget": 60}))
    episode.start(ground_truth_of(load_scene("box")), seed=0)
    (path,) = episode.agent.paths(episode.volume, episode.candidates.world_from_camera[row : row + 1])
    result = episode.move_to(row)
    assert path is not None and result.reached
    assert path.frames == result.frames and len(path.keyframes) == len(result.keyframes)
    np.testing.assert_array_equal(path.keyframes[-1], result.keyframes[-1].world_from_camera)
