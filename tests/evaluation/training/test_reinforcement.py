"""PPO on random candidates: learns, repeats exactly, goes on where it was killed, and keeps what it began from."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from activestructure_gym.evaluation.training.config import TrainingConfig
from activestructure_gym.evaluation.training.reinforcement import (
    on_one_thread,
    train_ppo,
    vector_env,
    whole_episodes,
)
from activestructure_gym.evaluation.training.runs import SCORE, TrainingRun
from activestructure_gym.policies.learned import learned_from
from activestructure_gym.policies.learned.checkpoint import load_network, save_checkpoint
from activestructure_gym.policies.learned.network import CandidateNetwork
from tests.policies.learned.toys import RandomCandidates

CONFIG = TrainingConfig(
    method="ppo", iterations=3, envs=2, steps=32, ppo_batch=32, ppo_epochs=2, planes=8, candidates=16,
    validate_every=3, critic_first=1,
)  # fmt: skip


class Killed(Exception):
    """Stands for a SIGKILL."""


def no_validation(network: CandidateNetwork) -> dict[str, float]:
    return {SCORE: 0.0}


def test_episodes_that_are_cut_do_not_count() -> None:
    rewards = np.array([[1.0, 10.0], [2.0, 20.0], [4.0, 40.0], [8.0, 80.0]])  # [steps, envs]
    starts = np.array([[1, 1], [0, 0], [1, 0], [0, 1]], bool)
    assert whole_episodes(rewards, starts) == pytest.approx(((3 + 70) / 2, 2.5))
    assert whole_episodes(rewards[:2], starts[:2]) is None


def train(config: TrainingConfig, place: Path, notify=lambda *_: None, validate=no_validation, processes=False):
    torch.set_num_threads(1)
    envs = vector_env([partial(RandomCandidates, 16, 5)] * config.envs, processes=processes)
    run = TrainingRun(place, config)
    try:
        return train_ppo(config, envs, run, validate, notify), run
    finally:
        envs.close()


@pytest.mark.slow
def test_ctrl_c_is_the_parents() -> None:
    envs = vector_env([partial(RandomCandidates, 16, 5)] * 2, processes=True)
    try:
        for process in envs.processes:  # type: ignore[attr-defined]
            os.kill(process.pid, signal.SIGINT)  # as a terminal does
        assert len(envs.reset()["action_mask"]) == 2  # type: ignore[call-overload]
    finally:
        envs.close()


@pytest.mark.slow
def test_processes_change_no_result(tmp_path: Path) -> None:
    train(CONFIG, tmp_path / "one")
    train(CONFIG, tmp_path / "several", processes=True)
    for name in ("last.safetensors", "log.jsonl"):
        assert (tmp_path / "several" / name).read_bytes() == (tmp_path / "one" / name).read_bytes(), name


@pytest.mark.slow
def test_learns_to_take_the_largest_gain(tmp_path: Path) -> None:
    config = replace(CONFIG, iterations=40, steps=64, ppo_epochs=4, learning_rate=3e-3, validate_every=40)
    _, run = train(config, tmp_path)
    rewards = [row["rollout/reward_per_step"] for row in run.rows()]
    assert sum(rewards[-3:]) / 3 > max(0.8, 1.5 * rewards[0])


def test_what_it_begins_from_is_kept_where_it_only_gets_worse(tmp_path: Path) -> None:
    torch.manual_seed(5)
    begun = CandidateNetwork(CONFIG.network())
    save_checkpoint(tmp_path / "start.safetensors", begun, {})
    spec = learned_from(str(tmp_path / "start")).spec.removeprefix("learned:")
    scores = iter([0.9, 0.5])
    config = replace(CONFIG, start=spec)
    trained, run = train(config, tmp_path / "run", validate=lambda network: {SCORE: next(scores)})
    best = load_network(tmp_path / "run" / "best.safetensors").state_dict()
    assert all(torch.equal(best[name], value) for name, value in begun.state_dict().items())
    assert run.best == 0.9
    assert not torch.equal(trained.scorer[0].weight, begun.scorer[0].weight)


def test_a_resumed_run_needs_its_beginning_no_more(tmp_path: Path) -> None:
    """Its state has replaced what it began from, which may be gone or changed by then."""
    torch.manual_seed(5)
    save_checkpoint(tmp_path / "start.safetensors", CandidateNetwork(CONFIG.network()), {})
    config = replace(CONFIG, start=learned_from(str(tmp_path / "start")).spec.removeprefix("learned:"))

    def kill_at(last: int) -> Callable[[int, Mapping[str, float]], None]:
        def kill(position: int, row: Mapping[str, float]) -> None:
            if position == last:
                raise Killed

        return kill

    train(config, tmp_path / "whole")
    for last in (0, 1):  # after the first validation, and after an iteration
        with pytest.raises(Killed):
            train(config, tmp_path / "killed", kill_at(last))
    (tmp_path / "start.safetensors").unlink()
    train(config, tmp_path / "killed")
    for name in ("last.safetensors", "log.jsonl", "state.safetensors"):
        assert (tmp_path / "killed" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name
    units = [row["unit"] for row in TrainingRun(tmp_path / "killed", config).rows()]
    assert units == [0, 1, 2, 3]


class Recorded(RandomCandidates):
    """Notes which layouts it was told to take."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict[str, Any], dict]:
        self.taken = [*getattr(self, "taken", []), *([options["layout"]] if options else [])]
        return super().reset(seed=seed, options=options)


def test_all_layouts_come_before_any_comes_again(tmp_path: Path) -> None:
    config = replace(CONFIG, world=replace(CONFIG.world, layouts=6), iterations=4)
    envs = vector_env([partial(Recorded, 16, 5)] * config.envs, processes=False)
    train_ppo(config, envs, TrainingRun(tmp_path, config), no_validation)
    taken = np.transpose(envs.get_attr("taken")).ravel()  # iteration by iteration
    assert sorted(taken[:6]) == list(range(6)) and list(taken[6:]) == list(taken[:2])
    envs.close()


def test_an_environment_s_process_has_one_thread() -> None:
    before = cv2.getNumThreads()
    try:
        cv2.setNumThreads(2)
        assert isinstance(on_one_thread(partial(RandomCandidates, 16, 5)), RandomCandidates)
        assert cv2.getNumThreads() == 1
    finally:
        cv2.setNumThreads(before)


def test_it_is_told_what_took_how_long(tmp_path: Path) -> None:
    train(replace(CONFIG, iterations=2, validate_every=2), tmp_path)
    told = json.loads((tmp_path / "timing.json").read_text())
    assert set(told["parts"]) == {"collecting", "updating", "validating"}
    assert told["parts"]["collecting"]["steps"] == 2 * CONFIG.envs * CONFIG.steps
    assert told["parts"]["collecting"]["steps_per_s"] > 0 and told["hardware"]["cores"] >= 1
    assert "reward per training episode" in (tmp_path / "curve.svg").read_text()


def test_at_first_only_the_critic_learns(tmp_path: Path) -> None:
    torch.manual_seed(5)
    begun = CandidateNetwork(CONFIG.network())
    save_checkpoint(tmp_path / "start.safetensors", begun, {})
    spec = learned_from(str(tmp_path / "start")).spec.removeprefix("learned:")
    trained, _ = train(replace(CONFIG, start=spec, iterations=1), tmp_path / "run")
    changed = {
        n.split(".")[0] for n, value in trained.state_dict().items() if not torch.equal(value, begun.state_dict()[n])
    }
    assert changed == {"critic"}
