"""Play one episode of a policy or the oracle, and compute the area under its coverage curve."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.evaluation.running.actors import chosen_row
from activestructure_gym.evaluation.statistics import area_under
from activestructure_gym.evaluation.training.config import WorldConfig
from activestructure_gym.evaluation.training.oracle import oracle_greedy
from activestructure_gym.evaluation.training.training_env import make_env
from activestructure_gym.ground_truth import GroundTruth
from activestructure_gym.policies import Policy

Choose = Callable[[ReconstructionEnv, dict[str, np.ndarray]], int]  # (environment, observation) -> row of a candidate


@dataclass(frozen=True)
class Played:
    """Hold the coverage of an episode as a curve over the number of frames taken."""

    frames: tuple[int, ...]  # number of frames taken so far, at the start and after every step
    coverage: tuple[float, ...]  # share of the observable surface that is seen, 0..1, at the same times
    budget: int  # frame budget of the episode

    @property
    def auc(self) -> float:
        """Return the mean coverage over the frame budget, 0..1; a step may take no frame, as a change of the stage."""
        curve = dict(zip(self.frames, self.coverage))  # of several steps at one frame, the last one counts
        return area_under(np.array(list(curve), np.float64), np.array(list(curve.values())), self.budget)


def play(env: ReconstructionEnv, choose: Choose, seed: int, start: np.ndarray | None = None) -> Played:
    """Play one whole episode with the actions of ``choose``, close ``env``, and return the coverage curve.

    The episode begins at the pose ``start`` [4, 4] (world_from_camera), or at a pose drawn by ``seed``.
    """
    with closing(env):
        observation, info = env.reset(seed=seed, options=None if start is None else {"start_pose": start})
        frames, coverage = [int(info["frames"])], [env.coverage.share]
        ended = not observation["action_mask"].any()
        while not ended:
            observation, _, terminated, truncated, info = env.step(choose(env, observation))
            frames.append(int(info["frames"]))
            coverage.append(env.coverage.share)
            ended = terminated or truncated
        return Played(tuple(frames), tuple(coverage), env.config.frame_budget)


def play_policy(
    world: WorldConfig, truth: GroundTruth, policy: Policy, seed: int, start: np.ndarray | None = None
) -> Played:
    """Play one episode of ``policy`` in the scene ``truth``, without noise; ``seed`` and ``start`` are as in `play`.

    Raise `InputError` if the policy chooses no row of the candidate table.
    """
    env = make_env(world, truth, features=policy.required_features)
    policy.bind(env)
    policy.reset(seed)
    name = type(policy).__name__
    return play(env, lambda _, observation: chosen_row(name, env, policy.act(observation)), seed, start)


def play_oracle(world: WorldConfig, truth: GroundTruth, seed: int, start: np.ndarray | None = None) -> Played:
    """Play one episode of the one-step oracle in the scene ``truth``; ``seed`` and ``start`` are as in `play`."""
    return play(make_env(world, truth, features=()), oracle_greedy, seed, start)


def normalised(values: Sequence[float], random: Sequence[float], oracle: Sequence[float]) -> float:
    """Normalise the mean of ``values`` such that the mean of random choice is 0 and that of the one-step oracle is 1.

    The arguments are scores of the same episodes. The means are normalised instead of each score, since the references
    may be almost equal in a single episode. The result is NaN if the means of the references are equal.
    """
    floor, ceiling = float(np.mean(random)), float(np.mean(oracle))
    return (float(np.mean(values)) - floor) / (ceiling - floor) if ceiling != floor else float("nan")
