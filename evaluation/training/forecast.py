"""Estimate the time of a training run from a short trial: a layout, an episode on it, a step of the optimiser."""

from __future__ import annotations

import time
from contextlib import closing
from dataclasses import dataclass

import numpy as np
import torch

from activestructure_gym.evaluation.training.config import ORACLE, WITH_TRUTH, TrainingConfig
from activestructure_gym.evaluation.training.oracle import expert_scores
from activestructure_gym.evaluation.training.training_env import learning_layouts, make_env
from activestructure_gym.ground_truth import Layout
from activestructure_gym.policies.learned.config import USED_KEYS
from activestructure_gym.policies.learned.network import CandidateNetwork, as_tensors

_MOST_STEPS = 12  # of the trial's episode


@dataclass(frozen=True)
class Trial:
    """Hold the processor seconds of the parts of a training run."""

    layout: float  # load a layout, or make it
    episode: float  # play an episode without labels
    labels: float  # score all candidates in all states of an episode with the expert
    update: float  # one step of the optimiser
    length: float  # number of steps of an episode
    slowness: float  # wall seconds per processor second


def forecast(config: TrainingConfig, trial: Trial, *, workers: int, files: int, units: int) -> tuple[float, float]:
    """Return the minutes of wall clock and of processor time that the rest of a run takes.

    ``workers`` is the number of processes that play training episodes. ``files`` of demonstrations are still to be
    collected, and ``units`` (epochs or iterations) are still to be trained.
    """
    if config.method == "ppo":
        steps = config.envs * config.steps
        collecting = units * (config.envs * trial.layout + steps / trial.length * trial.episode)
        updates = units * config.ppo_epochs * steps / config.ppo_batch
    else:
        episodes = config.world.episodes_per_layout
        collecting = files * (trial.layout + episodes * (trial.episode + trial.labels))
        updates = units * config.episodes * trial.length / config.batch
    # Two references, random choice and the oracle, are played first.
    rounds = 2 + units / config.validate_every if units else 0
    validating = config.validation_layouts * (trial.layout + rounds * trial.episode + trial.labels)
    alone = validating + updates * trial.update
    minute = 60 / trial.slowness
    return (collecting / workers + alone) / minute, (collecting + alone) / 60


def run_trial(config: TrainingConfig) -> Trial:
    """Play the first steps of an episode on a training layout, and take one step of an optimiser."""
    world, began, clock = config.world, time.monotonic(), time.process_time
    start = clock()
    noise = {"depth_noise": "kinect"} if world.noise else None
    teacher = ORACLE if config.method == "ppo" else config.teacher
    extra = () if teacher in WITH_TRUTH else (teacher,)
    layouts = [Layout(spec) for spec in learning_layouts(world, "train", 2, (*world.features, *extra))]
    with closing(make_env(world, layouts[0].truth(), noise=noise)) as env:
        env.reset(seed=0)  # loads the kernels
    loading = clock()
    truth = layouts[1].truth()
    len(truth.observable_surface.points), truth.scene.raycaster
    loaded = clock()
    with closing(make_env(world, truth, features=(*world.features, *extra), noise=noise)) as env:
        observation, info = env.reset(seed=0)
        labels, steps, ended = 0.0, 0, not observation["action_mask"].any()
        state = observation
        while not ended and steps < _MOST_STEPS:
            before = clock()
            expert_scores(teacher, env, observation)
            labels += clock() - before
            valid = np.flatnonzero(observation["action_mask"])
            observation, _, terminated, truncated, info = env.step(int(valid[len(valid) // 2]))
            steps, ended = steps + 1, terminated or truncated
        played = clock()
        share = 1.0 if ended else min(1.0, info["frames"] / env.config.frame_budget)
    update = _update_seconds(config, {key: state[key] for key in USED_KEYS})
    return Trial(
        layout=loaded - loading,
        episode=(played - loaded - labels) / share,
        labels=labels / share,
        update=update,
        length=max(1.0, steps / share),
        slowness=max(1.0, (time.monotonic() - began) / max(clock() - start, 1e-3)),
    )


def _update_seconds(config: TrainingConfig, state: dict[str, np.ndarray]) -> float:
    """Return the processor seconds of one gradient of the network; the second of two, since the first one allocates."""
    size = config.ppo_batch if config.method == "ppo" else config.batch
    state["candidate_features"] = state["candidate_features"][:, : len(config.network().features)]
    inputs = as_tensors({key: np.repeat(value[None], size, axis=0) for key, value in state.items()})
    with torch.random.fork_rng():
        network = CandidateNetwork(config.network())
    for _ in range(2):
        began = time.process_time()
        scores, values = network(inputs)
        (scores.logsumexp(1).mean() + values.mean()).backward()
    return time.process_time() - began
