"""Stages, staying, looking at a point on the way, and ending: what rows do besides being walked to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as sb3_check_env

from activestructure_gym.config import configure
from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.envs.observation import CANDIDATE_COLUMNS, row_columns
from activestructure_gym.errors import InputError
from activestructure_gym.features import FEATURES
from activestructure_gym.policies import make_env_and_policy
from activestructure_gym.policies.base import Policy
from activestructure_gym.sources import Proposals, Source

STAGES = [["pool", "stay?rounds=2", "finish"], ["around?rows=6", "turns?count=4"], ["turns?count=3"]]


def make(stages: Any = STAGES, frames: int = 40, **changes: Any) -> ReconstructionEnv:
    return ReconstructionEnv(
        "box",
        preset="fast",
        frame_budget=frames,
        config={
            "sensor": {"width": 64, "height": 36},
            "views": {"max_candidates": 24, "stages": stages},
            "keyframe_every": 5,
            **changes,
        },
    )


class Reader(Policy):
    def act(self, observation):
        return 0


def read(env: gym.Env, observation):
    reader = Reader()
    reader.bind(env)
    return reader.candidates(observation)


@pytest.fixture
def env() -> ReconstructionEnv:
    return make()


def test_both_checkers_pass_and_chance_ends_the_episode(env: ReconstructionEnv) -> None:
    check_env(env)
    sb3_check_env(env, warn=False)
    _, info = env.reset(seed=3)
    env.action_space.seed(3)
    for _ in range(400):  # asking costs no frame, and yet it cannot go on for ever
        observation, _, terminated, truncated, info = env.step(env.action_space.sample(info["action_mask"]))
        assert env.observation_space.contains(observation)
        if terminated or truncated:
            return
    raise AssertionError("no end after 400 steps")


def test_the_usual_table_has_no_further_columns() -> None:
    assert make([["pool"]]).observation_space["candidates"].names == CANDIDATE_COLUMNS
    assert row_columns([["pool", "stay"]]) == (
        *CANDIDATE_COLUMNS,
        "from_pool",
        "from_stay",
        "stay",
        "fixates",
        "at_x",
        "at_y",
        "at_z",
    )


def test_a_stage_is_asked_for_at_no_cost_and_once_until_a_frame_is_paid(env: ReconstructionEnv) -> None:
    observation, _ = env.reset(seed=0)
    rows = read(env, observation)
    assert rows.source("pool").any() and not rows.source("turns?count=4").any()
    assert rows.stage_switch(0) is None and rows.stage_switch(1) is not None and rows.stage_switch(2) is not None
    assert (
        rows.frames[rows.stage_switch(1)] == 0
        and rows.valid[rows.stage_switch(1)]
        and not observation["candidate_features"][rows.stage_switch(1)].any()
    )
    observation, reward, *_, info = env.step(rows.stage_switch(1))
    assert (info["frames"], info["metres"], info["invalid_action"], reward) == (1, 0.0, False, 0.0)
    rows = read(env, observation)
    assert rows.source("turns?count=4").sum() == 4 and not rows.source("pool").any()
    assert rows.stage_switch(0) is None and rows.stage_switch(1) is None and rows.stage_switch(2) is not None
    observation, *_ = env.step(rows.stage_switch(2))
    rows = read(env, observation)
    assert [rows.stage_switch(stage) for stage in range(3)] == [None] * 3 and rows.valid.sum() == 3
    observation, *_ = env.step(2)  # a frame is paid; the stage stays, and the others can be asked for again
    rows = read(env, observation)
    assert rows.source("turns?count=3").any() and rows.stage_switch(0) is not None and rows.stage_switch(1) is not None


def test_a_stage_with_nothing_to_offer_can_be_left_again() -> None:
    nothing = "frontier_facing?rows=4&nearest_m=98&farthest_m=99"
    env = make([["pool"], [nothing]])
    observation, _ = env.reset(seed=0)
    rows = read(env, observation)
    assert rows.source("pool").any()
    observation, _, terminated, truncated, info = env.step(rows.stage_switch(1))
    rows = read(env, observation)
    assert not terminated and not truncated and info["frames"] == 1
    assert rows.valid.sum() == 1 and rows.stage_switch(0) is not None  # nothing but the way back
    observation, *_ = env.step(rows.stage_switch(0))
    rows = read(env, observation)
    assert rows.source("pool").any() and rows.stage_switch(1) is None
    observation, _, terminated, *_, info = env.step(0)
    assert not terminated and info["frames"] > 1 and read(env, observation).stage_switch(1) is not None


def test_where_no_stage_has_anything_the_episode_ends() -> None:
    nothing = ["frontier_facing?rows=4&nearest_m=98&farthest_m=99"]
    env = make([nothing, ["frontier_facing?rows=3&nearest_m=98&farthest_m=99"]])
    observation, _ = env.reset(seed=0)
    asked = 0
    while observation["action_mask"].any():
        observation, _, terminated, truncated, _ = env.step(int(np.flatnonzero(observation["action_mask"])[0]))
        asked += 1
        assert asked < 4
    assert terminated or truncated


def test_staying_pays_the_frames_of_its_rounds_and_optimises(env: ReconstructionEnv) -> None:
    env = make(**{"mapper.iterations": 3})
    observation, _ = env.reset(seed=0)
    rows, episode = read(env, observation), env.reconstruction
    (row,) = np.nonzero(rows.source("stay?rounds=2"))[0]
    assert rows.stay[row] == 2 and rows.frames[row] == 10
    before, pose = episode.mapper.map.colors.copy(), episode.pose.copy()
    _, _, _, _, info = env.step(int(row))
    assert (info["frames"], info["metres"], info["keyframes"], info["reached"]) == (11, 0.0, 1, True)
    np.testing.assert_array_equal(episode.pose, pose)
    assert len(episode.trajectory) == 11 and not np.array_equal(episode.mapper.map.colors[: len(before)], before)
    while info["frames"] < 40:  # what the budget does not reach for is not paid
        mask = episode.candidates.stay > 0
        *_, truncated, info = env.step(int(np.nonzero(mask)[0][0]))
    assert info["frames"] == 40 and truncated


def test_finishing_ends_the_episode_once_something_was_paid(env: ReconstructionEnv) -> None:
    observation, _ = env.reset(seed=0)
    assert not read(env, observation).source("finish").any()
    observation, *_, info = env.step(0)
    rows = read(env, observation)
    (row,) = np.nonzero(rows.source("finish"))[0]
    paid = info["frames"]
    assert rows.frames[row] == 40 - paid
    assert not observation["candidate_features"][row].any() and not observation["candidate_planes"][row].any()
    *_, terminated, truncated, info = env.step(int(row))
    assert terminated and not truncated and info["frames"] == paid and info["is_success"] is False
    with pytest.raises(gym.error.ResetNeeded):
        env.step(0)


@pytest.mark.parametrize("name", ["unknown_volume", "unseen", "hole_area", "pixel_only", "frontier", "anm_s"])
def test_who_knows_nothing_of_it_does_not_end_the_episode_early(name: str) -> None:
    env, policy = make_env_and_policy(
        name,
        "room",
        preset="fast",
        frame_budget=60,
        config={"sensor": {"width": 48, "height": 27}, "views.stages": [["pool", "finish"]]},
    )
    policy.reset(0)
    observation, info = env.reset(seed=0)
    ended = False
    while not ended:
        observation, _, terminated, truncated, info = env.step(policy.act(observation))
        ended = terminated or truncated
    assert truncated and info["frames"] == 60


@dataclass(frozen=True)
class Gazing(Source):
    """To the pool's places, looking at the start on the way."""

    rows: int = 12

    def propose(self, context):
        table = context.pool.offer(context.volume, context.agent.distances, 0, context.revisits, room=self.rows)
        return Proposals(table.world_from_camera, look_at=np.tile(context.start + [0.0, 0.3, 0.1], (len(table), 1)))


GAZING = "tests.sources.test_hooks:Gazing"  # found without being registered, as a user's own


def test_a_point_is_looked_at_on_the_way() -> None:
    env = make([[GAZING, "turns?count=6"]], frames=100)
    observation, _ = env.reset(seed=0)
    rows, episode = read(env, observation), env.reconstruction
    for turn in (1, 2):
        observation, *_ = env.step(int(np.nonzero(rows.source("turns?count=6"))[0][turn]))
        rows = read(env, observation)
    point = episode.trajectory[0][:3, 3] + [0.0, 0.3, 0.1]
    gazing = rows.source(GAZING)
    np.testing.assert_allclose(rows.fixation_point[gazing], np.tile(point, (gazing.sum(), 1)), atol=1e-5)
    assert np.isnan(rows.fixation_point[~gazing]).all()
    far = int(np.argmax(np.where(gazing, rows.path_length, -1.0)))
    goal, before = episode.candidates.world_from_camera[far], len(episode.trajectory)
    env.step(far)
    way = np.array(episode.trajectory[before:])
    moved = np.nonzero(np.linalg.norm(np.diff(way[:, :3, 3], axis=0), axis=1) > 1e-9)[0] + 1
    towards = point - way[moved, :3, 3]
    cosine = (towards * way[moved, :3, 2]).sum(axis=1) / np.linalg.norm(towards, axis=1)
    assert len(moved) > 3 and cosine.min() > 1 - 1e-9
    np.testing.assert_allclose(way[-1], goal, atol=1e-9)


@dataclass(frozen=True)
class Scribbling(Source):
    """Its own place, after it has written into what it was shown."""

    rows: int = 4
    scribble: bool = False

    def propose(self, context):
        pose = context.agent.pose.copy()
        for shown in (context.agent.pose, context.bounds, context.start) if self.scribble else ():
            shown += 100.0
        return Proposals(np.array([pose]))


def scribbling(context):  # [K]
    """0 everywhere, after it has written into what it was shown."""
    for shown in (context.world_from_camera, context.agent.pose, context.bounds):
        shown[:] = 0.0
    return np.zeros(len(context.world_from_camera))


@pytest.mark.parametrize("scribble, features", [("true", ("pixel",)), ("false", ("scribbling",))])
def test_what_is_written_into_what_is_shown_moves_nobody(scribble, features, monkeypatch) -> None:
    monkeypatch.setattr(FEATURES, "_entries", dict(FEATURES._entries))
    FEATURES.register("scribbling", unit="-")(scribbling)
    ways = []
    for flag, asked in (("false", ("pixel",)), (scribble, features)):
        env = make([["pool", f"tests.sources.test_hooks:Scribbling?scribble={flag}"]], features=asked)
        env.reset(seed=0)
        for row in (3, 2):
            env.step(row)
        ways.append(np.array(env.reconstruction.trajectory))
    assert np.array_equal(*ways) and len(ways[0]) > 3


def test_without_hooks_a_reader_sees_the_pool_alone() -> None:
    env = make([["pool"]])
    observation, _ = env.reset(seed=0)
    rows = read(env, observation)
    assert rows.offers("pool") and not rows.offers("stay") and rows.stage_switch(0) is None
    np.testing.assert_array_equal(rows.source("pool"), rows.valid)
    assert not rows.stay.any() and np.isnan(rows.fixation_point).all()
    with pytest.raises(InputError, match=r"offers pool: name it in views\.stages"):
        rows.source("stay")


@pytest.mark.parametrize(
    ("stages", "message"),
    [
        ([], "1 to 16 stages"),
        ([[]], "at least one source"),
        ("pool", "must be a list"),
        ([["turns", "turns"]], "names a source twice: turns"),
        ([["turns?count=30"]], "needs 30 rows and views.max_candidates is 24"),
        ([["pool", "turns?count=23"], ["turns"]], "needs 25 rows"),
        ([["pol"]], "did you mean 'pool'"),
    ],
)
def test_stages_that_cannot_be_are_said(stages: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        configure("fast", {"views": {"max_candidates": 24, "stages": stages}})


def test_a_stay_of_thousands_of_frames_lies_within_the_observation_space() -> None:
    stages = [["pool", "stay?rounds=1000"]]
    env = make(stages, keyframe_every=20)
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    columns = row_columns(stages)
    rows = observation["candidates"][observation["candidates"][:, columns.index("stay")] > 0]
    assert rows[:, columns.index("stay")].tolist() == [1000] and rows[:, columns.index("frames")].tolist() == [10_000]
