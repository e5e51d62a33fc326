"""Train with PPO of stable-baselines3, in iterations that can be repeated exactly.

An iteration depends only on the seed, its number, and the weights and optimiser state before it. It begins with new
episodes, because a running episode cannot be saved. So a killed run loses one iteration, which is repeated exactly. The
cost is one unfinished episode per env and iteration. In an iteration each env has its own layout. The layouts are used
in turn.
"""

from __future__ import annotations

import random
import signal
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from activestructure_gym.evaluation.training.config import TrainingConfig
from activestructure_gym.evaluation.training.process_pool import one_thread, worker_context
from activestructure_gym.evaluation.training.runs import (
    TrainingRun,
    module_tensors,
    optimizer_tensors,
)
from activestructure_gym.evaluation.training.stopwatch import Timing
from activestructure_gym.evaluation.training.supervised import Notify, Validate
from activestructure_gym.evaluation.training.training_env import layout_order
from activestructure_gym.policies.learned.network import CandidateNetwork
from activestructure_gym.policies.learned.sb3 import CandidatePolicy

MakeEnv = Callable[[], gym.Env[Any, Any]]


def vector_env(makers: Sequence[MakeEnv], *, processes: bool) -> VecEnv:
    """Make a vector of environments, one by each function in ``makers``.

    With ``processes``, each environment is in its own process, else in this one; both give equal results.
    """
    if processes:
        method = worker_context(__name__).get_start_method()
        return SubprocVecEnv([partial(in_its_own_process, make) for make in makers], start_method=method)
    return DummyVecEnv(list(makers))


def in_its_own_process(make: MakeEnv) -> gym.Env[Any, Any]:
    """Make an environment in a worker process, with one thread; Ctrl-C is ignored, since the parent handles it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return on_one_thread(make)


def on_one_thread(make: MakeEnv) -> gym.Env[Any, Any]:
    """Limit OpenCV to one thread in this process, then make an environment."""
    one_thread()
    return make()


def train_ppo(
    config: TrainingConfig, envs: VecEnv, run: TrainingRun, validate: Validate, notify: Notify = lambda *_: None
) -> CandidateNetwork:
    """Train a network by PPO from the first unfinished iteration of ``run`` to the last, and return the network.

    ``envs`` is the result of `vector_env`. ``validate`` scores a network, and ``notify`` is called with the number of
    finished iterations and the log row.
    """
    torch.manual_seed(config.seed)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "You have specified a mini-batch size")  # the last batch may be smaller
        model = PPO(
            CandidatePolicy,
            envs,
            learning_rate=config.rate,
            n_steps=config.steps,
            batch_size=config.ppo_batch,
            n_epochs=config.ppo_epochs,
            gamma=config.gamma,
            gae_lambda=config.gae_lambda,
            clip_range=config.clip,
            ent_coef=config.entropy,
            target_kl=config.target_kl,
            policy_kwargs={"network": config.network().as_dict()},
            device="cpu",
        )
    model.set_logger(Logger(None, []))
    policy = model.policy
    assert isinstance(policy, CandidatePolicy)
    if run.tensors:
        run.restore(policy.network, policy.optimizer)
    elif config.start is not None:
        from activestructure_gym.policies.learned import learned_from

        policy.begin_from(learned_from(config.start).checkpoint)
        # The start checkpoint is validated too, so the best checkpoint is never worse than it.
        run.timing.switch("validating")
        row = dict(validate(policy.network))
        run.begin_with(row, policy.network)
        notify(0, row)

    order = layout_order(config.seed, config.world.layouts)
    while not run.ended:
        iteration = run.position
        _seed_everything(config.seed, iteration, envs)
        numbers = order[(iteration * config.envs + np.arange(config.envs)) % len(order)]
        envs.set_options([{"layout": int(number)} for number in numbers])
        model.num_timesteps = iteration * config.envs * config.steps
        model._n_updates = iteration * config.ppo_epochs
        model._last_obs = None  # makes stable-baselines3 reset the envs with the seeds above
        _let_learn(policy.network, critic_only=config.start is not None and iteration < config.critic_first)
        steps, watch = config.envs * config.steps, _Watch(run.timing)
        run.timing.switch("collecting")
        model.learn(steps, callback=watch, reset_num_timesteps=False, log_interval=None)  # type: ignore[arg-type]
        run.timing.count("collecting", steps)
        row = _row(model)
        if (iteration + 1) % config.validate_every == 0 or iteration + 1 == config.iterations:
            run.timing.switch("validating")
            row |= validate(policy.network)
        run.finish_unit(row, policy.network, module_tensors(policy.network) | optimizer_tensors(policy.optimizer))
        notify(run.position, row)
    return policy.network


class _Watch(BaseCallback):
    """Switch the stopwatch of a run from "collecting" to "updating" when PPO has collected its steps."""

    def __init__(self, timing: Timing) -> None:
        super().__init__()
        self._timing = timing

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        self._timing.switch("updating")


def _seed_everything(seed: int, iteration: int, envs: VecEnv) -> None:
    """Seed the envs and the global generators of Python, numpy and torch for one iteration.

    stable-baselines3 draws actions by torch and batches by numpy.
    """
    one, two, three, four = (int(n) for n in np.random.SeedSequence([seed, iteration]).generate_state(4))
    random.seed(one)
    np.random.seed(two)  # noqa: NPY002
    torch.manual_seed(three)
    envs.seed(four % 2**31)


def _let_learn(network: CandidateNetwork, *, critic_only: bool) -> None:
    for name, parameter in network.named_parameters():
        parameter.requires_grad_(name.startswith("critic.") or not critic_only)


def _row(model: PPO) -> dict[str, float]:
    """Return the log row of an iteration: the training statistics of stable-baselines3, and mean rewards."""
    row = {name: float(value) for name, value in model.logger.name_to_value.items() if name.startswith("train/")}
    model.logger.name_to_value.clear()
    rewards, starts = model.rollout_buffer.rewards, model.rollout_buffer.episode_starts
    row["rollout/reward_per_step"] = float(rewards.mean())
    whole = whole_episodes(rewards, starts)
    if whole is not None:
        row["rollout/reward_per_episode"], row["rollout/steps_per_episode"] = whole
    return row


def whole_episodes(rewards: np.ndarray, starts: np.ndarray) -> tuple[float, float] | None:  # both [steps, envs]
    """Return the mean reward and the mean number of steps of the episodes that are followed by another one.

    ``rewards`` and ``starts`` [steps, envs] are of one iteration; ``starts`` is 1 at the first step of an episode.
    Return None if there is no such episode.
    """
    totals, lengths = list[float](), list[int]()
    for earned, begins in zip(rewards.T, starts.T):
        bounds = np.flatnonzero(begins)
        totals += [float(earned[first:last].sum()) for first, last in zip(bounds[:-1], bounds[1:])]
        lengths += np.diff(bounds).tolist()
    return (float(np.mean(totals)), float(np.mean(lengths))) if totals else None
