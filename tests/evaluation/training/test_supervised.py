"""Copying an expert on random states: it works in seconds, repeats exactly, and goes on where it was killed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS
from activestructure_gym.evaluation.training.config import TrainingConfig
from activestructure_gym.evaluation.training.demonstrations import Demonstrations
from activestructure_gym.evaluation.training.runs import SCORE, TrainingRun
from activestructure_gym.evaluation.training.supervised import train_supervised
from activestructure_gym.policies.learned.checkpoint import load_network
from activestructure_gym.policies.learned.config import USED_KEYS
from activestructure_gym.policies.learned.network import CandidateNetwork, as_tensors
from tests.policies.learned.toys import random_observation

CONFIG = TrainingConfig(method="bc", epochs=12, batch=32, validate_every=4, learning_rate=3e-3, planes=8, candidates=24)


def demonstrations(seed: int, states: int = 240) -> Demonstrations:
    """An expert who takes the product of both features and the travel discount, which no single input shows."""
    rng = np.random.default_rng(seed)
    seen = [random_observation(rng, 16, int(rng.integers(2, 16)), 5) for _ in range(states)]
    observations = {key: np.stack([one[key] for one in seen]) for key in USED_KEYS}
    frames = observations["candidates"][..., CANDIDATE_COLUMNS.index("frames")]
    scores = observations["candidate_features"].prod(-1) / (1 + frames / 5) * observations["action_mask"]
    ends, actions = np.arange(states) % 6 == 5, scores.argmax(axis=1).astype(np.int16)
    return Demonstrations(observations, scores.astype(np.float32), rng.random(states), ends, actions)


@pytest.fixture(scope="module")
def data() -> Demonstrations:
    return demonstrations(0)


@pytest.fixture(scope="module")
def fresh() -> Demonstrations:
    return demonstrations(1, states=120)


def reached(network: CandidateNetwork, data: Demonstrations) -> float:
    """The chosen candidates' scores as a share of the best there were."""
    with torch.no_grad():
        chosen = network(as_tensors(data.observations))[0].argmax(1).numpy()
    return float((data.scores[np.arange(len(data)), chosen] / data.scores.max(1)).mean())


def validation(fresh: Demonstrations):
    return lambda network: {SCORE: reached(network, fresh)}


@pytest.mark.slow
@pytest.mark.parametrize("method", ["bc", "rank"])
def test_beats_random_on_states_it_was_not_trained_on(method: str, data, fresh, tmp_path: Path) -> None:
    config = replace(CONFIG, method=method)
    run = TrainingRun(tmp_path, config)
    network = train_supervised(config, data, run, validation(fresh))
    valid = fresh.observations["action_mask"] > 0
    best = fresh.scores.max(1)
    random = float(np.mean([s[v].mean() / b for s, v, b in zip(fresh.scores, valid, best)]))
    assert reached(network, fresh) > max(0.8, 1.5 * random)
    losses = [row["train/loss"] for row in run.rows()]
    assert len(losses) == 12 and losses[-1] < losses[0]
    assert [SCORE in row for row in run.rows()] == [n % 4 == 3 for n in range(12)]
    assert reached(load_network(tmp_path / "best.safetensors"), fresh) == pytest.approx(run.best)


class Killed(Exception):
    """Stands for a SIGKILL: nothing after it is run."""


def weights(place: Path) -> bytes:
    return (place / "last.safetensors").read_bytes() + (place / "best.safetensors").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("moment", ["between units", "before the state is written", "before the last state is written"])
def test_a_killed_run_that_is_resumed_equals_one_that_was_not(
    moment: str, data, fresh, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = replace(CONFIG, epochs=4, validate_every=2)
    train_supervised(config, data, TrainingRun(tmp_path / "whole", config), validation(fresh))
    train_supervised(config, data, TrainingRun(tmp_path / "again", config), validation(fresh))
    assert weights(tmp_path / "again") == weights(tmp_path / "whole")  # deterministic

    last = 4 if "last" in moment else 2

    def kill(position: int, row: Mapping[str, float]) -> None:
        if position == last:
            raise Killed

    first = TrainingRun(tmp_path / "killed", config)
    if moment != "between units":
        save = first._save
        monkeypatch.setattr(first, "_save", lambda *a: save(*a) if first.position < last else kill(last, {}))
    with pytest.raises(Killed):
        train_supervised(config, data, first, validation(fresh), kill)
    with open(tmp_path / "killed" / "log.jsonl", "a") as log:
        log.write('{"unit": 3, "train/lo')  # torn
    second = TrainingRun(tmp_path / "killed", config)
    assert second.position == (2 if moment == "between units" else last - 1)
    train_supervised(config, data, second, validation(fresh))
    assert weights(tmp_path / "killed") == weights(tmp_path / "whole")
    for name in ("log.jsonl", "curve.svg"):
        assert (tmp_path / "killed" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_another_seed_is_another_network(data, tmp_path: Path) -> None:
    config = replace(CONFIG, epochs=1)
    networks = []
    for seed in (0, 1):
        other = replace(config, seed=seed)
        networks.append(train_supervised(other, data, TrainingRun(tmp_path / str(seed), other), lambda _: {SCORE: 0.0}))
    one, two = (network.scorer[0].weight for network in networks)
    assert not torch.equal(one, two)
