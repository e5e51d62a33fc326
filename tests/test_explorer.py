"""The planner as a library: the same episode as the environment's, pushed by its caller."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from activestructure_gym import Explorer
from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation import read_run
from activestructure_gym.evaluation.replay.recording import play_again
from activestructure_gym.evaluation.reproduction.verifying import verify
from activestructure_gym.policies import make_policy
from activestructure_gym.worlds import CaptureFailed
from activestructure_gym.worlds.simulated_world import SimulatedRobot

SMALL: dict[str, Any] = {"preset": "fast", "frame_budget": 50}


def robot() -> SimulatedRobot:
    return SimulatedRobot("box", width=64, height=36)


def explorer_of(camera: SimulatedRobot, policy: str = "hole_area", **options: Any) -> Explorer:
    start = camera.start
    given = {"camera": camera.camera, "bounds": camera.bounds, "start": start.pose, "free_radius": start.free_radius}
    return Explorer(policy, **given, **SMALL, **options)


def observe(explorer: Explorer, camera: SimulatedRobot, pose: np.ndarray) -> None:
    frame = camera.capture(pose)
    explorer.observe(frame.rgb, frame.depth, frame.world_from_camera)


def explored(explorer: Explorer, camera: SimulatedRobot, most: int = 100) -> int:
    """Follow the explorer's goals; the number of pictures."""
    for number in range(most):
        goal = explorer.next_view()
        if goal is None:
            return number
        observe(explorer, camera, goal.pose)
    return most


def test_an_explorer_plays_the_episode_of_the_environment(tmp_path: Path) -> None:
    camera = robot()
    explorer = explorer_of(camera)
    observe(explorer, camera, camera.start.pose)
    taken = explored(explorer, camera)

    policy = make_policy("hole_area")
    other = robot()
    other.reset = lambda seed: None  # type: ignore[method-assign]
    env = ReconstructionEnv(other, features=policy.required_features, coverage_target=None, **SMALL)
    policy.bind(env)
    observation, _ = env.reset(seed=0)
    policy.reset(0)
    ended = False
    while not ended:
        observation, _, terminated, truncated, _ = env.step(policy.act(observation))
        ended = terminated or truncated

    one, two = explorer.reconstruction, env.reconstruction
    np.testing.assert_array_equal(np.stack(one.trajectory), np.stack(two.trajectory))
    np.testing.assert_array_equal(one.mapper.map.parameters, two.mapper.map.parameters)
    assert taken + 1 == len(one.keyframe_indices) and one.frames == 50

    place = explorer.save(tmp_path / "run")
    run = read_run(place)
    assert not run.has_truth and run.metrics["metrics"]["completion_ratio"] is None
    assert run.metrics["metrics"]["known_m3"] > 0 and run.metrics["metrics"]["ended"] == "frame budget used up"
    assert verify(run).verdict == "identical"
    assert len(play_again(run).moments) == len(run.steps) + 1
    explorer.close()


def test_goals_say_the_way_and_why() -> None:
    camera = robot()
    explorer = explorer_of(camera)
    first = explorer.next_view()
    assert first is not None and not first.scores
    np.testing.assert_array_equal(first.pose, camera.start.pose)
    observe(explorer, camera, camera.start.pose)
    goal = explorer.next_view()
    assert goal is not None and goal is explorer.next_view()  # asking again changes nothing
    np.testing.assert_array_equal(goal.path[-1], goal.pose)
    assert set(goal.scores) >= {"hole_area"} and goal.view.shape == (4, 4)
    steps = np.linalg.norm(np.diff(goal.path[:, :3, 3], axis=0), axis=1)
    assert (steps <= explorer.reconstruction.config.motion.max_step_m + 1e-9).all()
    explorer.close()
    explorer.close()


def test_a_stopped_exploration_is_a_run(tmp_path: Path) -> None:
    camera = robot()
    explorer = explorer_of(camera)
    observe(explorer, camera, camera.start.pose)
    explored(explorer, camera, most=2)
    explorer.stop()
    assert explorer.next_view() is None
    with pytest.raises(InputError, match="has ended"):
        observe(explorer, camera, camera.start.pose)
    run = read_run(explorer.save(tmp_path / "run"))
    assert run.metrics["metrics"]["ended"] == "stopped" and run.metrics["metrics"]["keyframes"] == 3
    assert verify(run).verdict == "identical"
    with pytest.raises(InputError, match="exists already"):
        explorer.save(tmp_path / "run")
    explorer.close()


def test_an_interrupted_exploration_goes_on(tmp_path: Path) -> None:
    camera = robot()
    explorer = explorer_of(camera, directory=tmp_path / "run")
    observe(explorer, camera, camera.start.pose)
    explored(explorer, camera, most=2)
    left = explorer.next_view()  # the program is killed here
    assert left is not None and not explorer.resumed

    begin = robot()
    again = Explorer(
        "hole_area", camera=begin.camera, bounds=begin.bounds, start=begin.start.pose,
        free_radius=begin.start.free_radius, directory=tmp_path / "run", **SMALL,
    )  # fmt: skip
    assert again.resumed
    goal = again.next_view()
    assert goal is not None
    np.testing.assert_array_equal(goal.pose, left.pose)
    explored(again, camera)
    assert again.save() == tmp_path / "run" and not (tmp_path / "run.captures").exists()
    assert len(list((tmp_path / "run" / "captures").glob("*.npz"))) == len(again.reconstruction.keyframe_indices)


def test_a_view_that_cannot_be_reached_is_replaced_and_the_fourth_ends_it() -> None:
    camera = robot()
    explorer = explorer_of(camera)
    observe(explorer, camera, camera.start.pose)
    goal = explorer.next_view()
    assert goal is not None
    explorer.failed("a door is closed")
    other = explorer.next_view()
    assert other is not None and not np.array_equal(goal.view, other.view)
    episode = explorer.reconstruction
    assert episode.frames - len(other.path) == 2 and len(episode.keyframe_indices) == 1  # the failure costs one frame
    for _ in range(3):
        assert explorer.next_view() is not None
        explorer.failed("a door is closed")
    with pytest.raises(CaptureFailed, match="a door is closed"):
        explorer.next_view()


def test_infinite_depth_reaches_the_episode_as_no_surface_and_not_as_no_measurement(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    camera, frames = robot(), list[Any]()
    explorer = explorer_of(camera)
    frame = camera.capture(camera.start.pose)
    explorer.next_view()
    put = explorer._robot.answers.put
    monkeypatch.setattr(explorer._robot.answers, "put", lambda answer: (frames.append(answer), put(answer)))
    depth = np.full(frame.depth.shape, np.inf, np.float32)
    depth[0, 0] = 0.0
    explorer.observe(frame.rgb, depth, frame.world_from_camera)
    assert np.isposinf(frames[0].depth).sum() == depth.size - 1 and frames[0].unmeasured.sum() == 1
    monkeypatch.undo()
    explorer.close()


def test_wrong_pictures_are_refused_and_lose_nothing() -> None:
    camera = robot()
    explorer = explorer_of(camera)
    with pytest.raises(InputError, match="aspect ratios"):
        explorer.observe(np.zeros((40, 40, 3), np.uint8), np.ones((40, 40)), camera.start.pose)
    observe(explorer, camera, camera.start.pose)
    assert explorer.next_view() is not None
    explorer.close()


def test_wrong_arguments() -> None:
    camera = robot()
    with pytest.raises(InputError, match="unknown policy"):
        explorer_of(camera, "hole_aera")
    for field in ("mapper.iteratons", "iteratons"):
        with pytest.raises(InputError, match="unknown field 'iteratons'"):
            Explorer(camera=camera.camera, bounds=camera.bounds, start=camera.start.pose, config={field: 3})
    with pytest.raises(InputError, match="unknown preset 'fats'"):
        Explorer(camera=camera.camera, bounds=camera.bounds, start=camera.start.pose, preset="fats")  # type: ignore
    with pytest.raises(InputError, match="outside the world's bounds"):
        Explorer(camera=camera.camera, bounds=camera.bounds + 20.0, start=camera.start.pose)
    with pytest.raises(InputError, match="PinholeCamera"):
        Explorer("random", camera=None, bounds=[[0, 0, 0], [4, 3, 2.5]], start=np.eye(4))  # type: ignore[arg-type]


def test_an_exploration_without_a_picture_is_not_saved(tmp_path: Path) -> None:
    camera = robot()
    explorer = explorer_of(camera, directory=tmp_path / "run")
    with pytest.raises(InputError, match="no picture to save"):
        explorer.save()
    observe(explorer, camera, camera.start.pose)
    assert explorer.save().is_dir()
    explorer.close()


def test_an_exploration_can_be_closed_at_any_time(tmp_path: Path) -> None:
    explorer_of(robot()).close()
    camera = robot()
    explorer = explorer_of(camera)
    observe(explorer, camera, camera.start.pose)
    for _ in range(3):  # the fourth failure would be an error, but not that of `stop`
        explorer.failed()
    assert (explorer.save(tmp_path / "run") / "metrics.json").is_file()
    explorer.close()


def test_an_error_of_the_policy_reaches_the_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    from activestructure_gym.policies import Policy

    monkeypatch.setattr(type(make_policy("hole_area")), "act", lambda self, observation: 1 / 0)
    camera = robot()
    for fails in ("next_view", "close"):
        explorer = explorer_of(camera)
        observe(explorer, camera, camera.start.pose)
        with pytest.raises(ZeroDivisionError):
            getattr(explorer, fails)()
        folder = explorer.directory.parent
        for _ in range(2):
            explorer.close()  # the error has been raised
            assert not folder.exists()
    assert issubclass(type(make_policy("hole_area")), Policy)
