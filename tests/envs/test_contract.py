"""The Gymnasium contract, over every registered environment."""

from __future__ import annotations

import copy
import functools
import inspect
import multiprocessing
import pickle
import warnings
from collections.abc import Iterator
from multiprocessing.pool import Pool
from pathlib import Path
from typing import Any

import cv2
import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as sb3_check_env

from activestructure_gym.envs import ENV_IDS, ReconstructionEnv, tasks
from activestructure_gym.envs.observation import CANDIDATE_COLUMNS, feature_names
from activestructure_gym.envs.reconstruction_env import EnvOptions
from activestructure_gym.envs.registration import TASKS
from activestructure_gym.errors import InputError
from activestructure_gym.planes import PLANE_FEATURES
from tests.envs.conftest import options_of

# SB3 tells that its default extractor would flatten two-dimensional boxes; ours are tables, not images.
EXPECTED_WARNINGS = ("unconventional shape",)


def digest(value: Any) -> Any:
    """Something exact to compare: arrays by bytes, the rest as it is."""
    if isinstance(value, np.ndarray):
        return value.shape, value.dtype.str, value.tobytes()
    if isinstance(value, dict):
        return {key: digest(one) for key, one in value.items()}
    return value


def rollout(env_id: str, options: dict[str, Any], steps: int) -> list[Any]:
    env = gym.make(env_id, disable_env_checker=True, **options)
    seen = []
    episode = 0
    observation, info = env.reset(seed=11)
    env.action_space.seed(5)
    for _ in range(steps):
        seen.append(digest((observation, info)[0]) | {"info": digest(info)})
        action = env.action_space.sample(info["action_mask"])
        observation, reward, terminated, truncated, info = env.step(action)
        seen.append((int(action), reward, terminated, truncated))
        if terminated or truncated:
            episode += 1
            observation, info = env.reset()
    env.close()
    return seen


def test_both_checkers_pass_without_unexpected_warnings(env_id: str, options: dict[str, Any]) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(gym.make(env_id, disable_env_checker=True, **options).unwrapped)
        sb3_check_env(gym.make(env_id, disable_env_checker=True, **options).unwrapped)
    ours = [str(w.message) for w in caught if issubclass(w.category, UserWarning)]
    assert [m for m in ours if not any(expected in m for expected in EXPECTED_WARNINGS)] == []


@pytest.fixture(scope="module")
def other_process() -> Iterator[Pool]:
    """A process that shares nothing with this one but the files; the same for every environment."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        yield pool


def test_same_seed_same_steps_in_two_processes(env_id: str, options: dict[str, Any], other_process: Pool) -> None:
    """Thirty in one environment and, since the others differ in their scene alone, fifteen in each of those."""
    steps = 30 if "Room" in env_id else 15
    elsewhere = other_process.apply_async(rollout, (env_id, options, steps))
    here = rollout(env_id, options, steps)
    there = elsewhere.get(timeout=240)
    assert len(here) == len(there) == 2 * steps
    for index, (first, second) in enumerate(zip(here, there)):
        assert first == second, f"entry {index} differs"


def test_pickle_round_trip(env_id: str, options: dict[str, Any]) -> None:
    env = gym.make(env_id, disable_env_checker=True, **options).unwrapped
    fresh = pickle.loads(pickle.dumps(env))
    first, second = env.reset(seed=1), fresh.reset(seed=1)
    assert digest(first[0]) == digest(second[0])
    midway = pickle.loads(pickle.dumps(env))  # an episode in progress travels too
    one, other = env.step(0), midway.step(0)
    assert digest(one[0]) == digest(other[0])
    assert one[1:4] == other[1:4]


def test_the_names_of_the_columns_travel_with_the_space(env_id: str, options: dict[str, Any]) -> None:
    env = gym.make(env_id, features=("hole_area", "pixel"), **options)
    space = env.observation_space
    assert space["candidate_features"].names == ("hole_area", "pixel")
    assert space["candidates"].names == CANDIDATE_COLUMNS and space["plane_features"].names == PLANE_FEATURES
    for again in (
        pickle.loads(pickle.dumps(space)),
        copy.deepcopy(space),
        gym.wrappers.TimeLimit(env, 5).observation_space,
    ):
        assert again == space and again["candidate_features"].names == space["candidate_features"].names
    turned = gym.make(env_id, features=("pixel", "hole_area"), **options).observation_space
    assert turned != space and turned["candidates"] == space["candidates"]
    plain = gym.spaces.Box(-1e6, 1e6, space["candidate_features"].shape)
    assert plain == space["candidate_features"] == plain  # of which nothing is known
    _, info = env.reset(seed=0)
    assert (
        info["features"]
        == ("hole_area", "pixel")
        == env.step(int(np.flatnonzero(info["action_mask"])[0]))[4]["features"]
    )


def test_spec_survives_json(env_id: str, options: dict[str, Any]) -> None:
    env = gym.make(env_id, disable_env_checker=True, **options)
    spec = gym.envs.registration.EnvSpec.from_json(env.spec.to_json())
    again = gym.make(spec, disable_env_checker=True)
    assert digest(again.reset(seed=2)[0]) == digest(env.reset(seed=2)[0])


def test_observations_lie_in_their_space_and_masks_agree(env_id: str, options: dict[str, Any]) -> None:
    env = gym.make(env_id, disable_env_checker=True, **options).unwrapped
    observation, info = env.reset(seed=3)
    rng = np.random.default_rng(0)
    for _ in range(12):
        for name, space in env.observation_space.items():
            assert space.contains(observation[name]), name
            assert np.isfinite(space.low).all() and np.isfinite(space.high).all(), name
        np.testing.assert_array_equal(info["action_mask"], observation["action_mask"])
        np.testing.assert_array_equal(info["action_mask"], env.action_masks())
        assert info["action_mask"].any()
        unused = observation["action_mask"] == 0
        assert (observation["candidates"][unused] == 0).all()
        assert (observation["candidate_features"][unused] == 0).all()
        assert (observation["candidate_planes"][unused] == 0).all()
        observation, _, terminated, truncated, info = env.step(int(rng.choice(np.flatnonzero(info["action_mask"]))))
        if terminated or truncated:
            observation, info = env.reset()


def assert_vectorised(envs: gym.vector.VectorEnv, count: int) -> None:
    try:
        observation, info = envs.reset(seed=4)
        assert observation["rgb"].shape == (count, 36, 64, 3)
        assert feature_names(envs) == ("pixel",) and info["features"].tolist() == [("pixel",)] * count
        # Other seeds, other episodes; candidates may be equal, since two of the scenes have the same shape.
        assert len({picture.tobytes() for picture in observation["rgb"]}) == count
        for _ in range(3):
            actions = np.array([np.flatnonzero(mask)[0] for mask in observation["action_mask"]])
            observation, reward, *_ = envs.step(actions)
        assert reward.shape == (count,)
    finally:
        envs.close()


def test_vectorised(env_id: str, options: dict[str, Any]) -> None:
    assert_vectorised(gym.make_vec(env_id, num_envs=2, vectorization_mode="sync", **options), 2)


@pytest.mark.slow
def test_vectorised_in_processes(scene_files: dict[str, str]) -> None:
    makers = [
        functools.partial(gym.make, f"activestructure_gym:{name}", **options_of(name, scene_files)) for name in ENV_IDS
    ]
    multiprocessing.set_forkserver_preload(["activestructure_gym.envs.preload"])
    assert_vectorised(gym.vector.AsyncVectorEnv(makers, context="forkserver"), len(ENV_IDS))


def test_every_environment_has_a_page_in_gymnasium_s_format(env_id: str) -> None:
    entry_point = gym.spec(env_id.split(":", 1)[1]).entry_point
    module, _, name = entry_point.partition(":")
    page = getattr(__import__(module, fromlist=[name]), name).__doc__
    sections = [
        "Description",
        "Action Space",
        "Observation Space",
        "Rewards",
        "Starting State",
        "Episode End",
        "Arguments",
        "Reset options",
        "Info",
        "Version History",
    ]
    assert [f"## {section}" for section in sections] == [
        line.strip() for line in page.splitlines() if line.strip().startswith("## ")
    ]
    assert f"\n**{env_id.split('/')[1]}**" in page


def test_the_page_of_an_environment_has_one_indent_in_every_python(monkeypatch: pytest.MonkeyPatch) -> None:
    for stored in (ReconstructionEnv.__doc__, inspect.cleandoc(ReconstructionEnv.__doc__ or "")):  # from 3.13 on
        monkeypatch.setattr(ReconstructionEnv, "__doc__", stored)
        kind = type("New", (ReconstructionEnv,), {"__init__": lambda self, *, size=1, **options: None})
        page = tasks.task("**New-v0**: new.", size="int | 1 | its size")(kind).__doc__ or ""
        assert "\n**New-v0**: new.\n" in page and "\n| `size` | int | 1 | its size |\n| `preset` |" in page


@pytest.mark.parametrize("env_id", ENV_IDS)
def test_what_make_takes_stands_in_the_signature_of_the_task(env_id: str) -> None:
    kind = getattr(tasks, TASKS[env_id.partition("/")[2]])
    named = inspect.signature(kind).parameters
    assert set(EnvOptions.__annotations__) | {"world" if "World" in env_id else "scene"} <= set(named)
    assert set(EnvOptions.__annotations__) == set(inspect.signature(ReconstructionEnv).parameters) - {"scene"}
    assert all(one.kind is one.KEYWORD_ONLY for one in named.values())


def test_a_keyword_that_nobody_knows_is_refused_with_the_nearest() -> None:
    with pytest.raises(InputError, match=r"unexpected keyword argument 'frame_buget'; did you mean 'frame_budget'\?"):
        gym.make(ENV_IDS[0], scene="box", frame_buget=3)


def as_torchrl_makes(env_id: str, **options: Any) -> gym.Env[Any, Any]:
    """Make an environment as TorchRL's ``GymEnv`` does: with a keyword for Atari, which is taken back if refused so."""
    try:
        return gym.make(env_id, frameskip=1, **options)
    except TypeError as error:
        if "unexpected keyword argument 'frameskip'" not in str(error):
            raise
    return gym.make(env_id, **options)


def test_torchrl_makes_every_environment_by_name(env_id: str, options: dict[str, Any]) -> None:
    env = as_torchrl_makes(env_id, **options)
    env.reset(seed=0)
    env.close()
    kind = TASKS[env_id.partition("/")[2]]
    with pytest.raises(InputError) as error:
        gym.make(env_id, frameskip=1, **options)
    assert isinstance(error.value, TypeError)
    assert str(error.value).startswith(f"{kind}.__init__() got an unexpected keyword argument 'frameskip'")  # Python's


def test_record_video_writes_a_picture_per_step(env_id: str, options: dict[str, Any], tmp_path: Path) -> None:
    pytest.importorskip("moviepy", reason="pip install 'activestructure-gym[video]'")
    from gymnasium.wrappers import RecordVideo

    env = RecordVideo(gym.make(env_id, disable_env_checker=True, render_mode="rgb_array", **options), str(tmp_path))
    _, info = env.reset(seed=0)
    for row in (1, 2):
        env.step(np.int64(row))
    env.close()
    (path,) = tmp_path.glob("*.mp4")
    film, pictures = cv2.VideoCapture(str(path)), []
    while (read := film.read())[0]:
        pictures.append(read[1].astype(int))
    assert len(pictures) == 3 and film.get(cv2.CAP_PROP_FPS) == env.metadata["render_fps"]
    assert all(np.abs(now - then).mean() > 0.5 for then, now in zip(pictures, pictures[1:]))
