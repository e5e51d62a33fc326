"""Define the training environment, which draws the layout, the start pose and the sensor noise of an episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from activestructure_gym.config import Preset, ReconstructionConfig, configure, replaced
from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.envs.observation import observation_space
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.training.config import Reward, WorldConfig
from activestructure_gym.ground_truth import GroundTruth, Layout
from activestructure_gym.ground_truth.layouts import layout_specs
from activestructure_gym.policies.learned.config import USED_KEYS

_PERFECT_SHARE = 0.3  # share of episodes without sensor noise; comparisons have none
_DRAWN = ("sensor.depth_noise", "sensor.noise_multiplier", "sensor.edge_dropout")  # settings drawn by `draw_noise`
_NOISE_RANGE = (0.5, 2.0)  # multiples of the Kinect depth noise
_RATE_FRAMES = 5.0  # frames; constant of the travel discount 1 / (1 + frames / 5) of all greedy planners
_COLOUR_BLIND = ("pixel", "hole_area", "structure", "unknown_volume", "unknown_volume_way")  # independent of colours
_OF_THE_MAP = (  # these features are the same for all candidates if no Gaussians are mapped
    "activepolicy", "deficiency", "fisherrf", "fisherrf_path", "gauss_mi", "next_best_sense", "pixel",
    "popgs_cov_trace", "popgs_cov_trace_block", "popgs_info_trace", "popgs_logdet", "popgs_logdet_block",
    "popgs_min_eig", "uncovered", "unseen_sides", "view_angle",
)  # fmt: skip
STARTS = 16  # number of start poses without a candidate after which another layout is drawn


def world_config(world: WorldConfig, features: Sequence[str] | None = None) -> ReconstructionConfig:
    """Return the configuration of training episodes without sensor noise.

    ``features`` replaces the features of ``world``. Raise `InputError` if the overrides of ``world`` set the features,
    or set noise that every episode draws, or if a feature reads the map and nothing is mapped.
    """
    changes: dict[str, Any] = {"features": tuple(world.features if features is None else features)}
    drawn = [name for name, _ in world.overrides if name in _DRAWN]
    if world.noise and drawn:
        raise InputError(
            f"{', '.join(drawn)}: every training episode draws its own noise; --no-noise keeps one for all"
        )
    if "features" in dict(world.overrides):
        raise InputError("the policy's features are set by --features, not by --set features=...")
    if world.frames is not None:
        changes["frame_budget"] = world.frames
    config = configure(world.preset, dict(world.overrides) | changes)
    empty = [name for name in config.features if name in _OF_THE_MAP]
    if empty and not config.mapper.enabled:
        raise InputError(
            f"the feature '{empty[0]}' reads the map, which is empty here (mapper.enabled=false): use unknown_volume, "
            "which reads the volume, or another preset than rl"
        )
    return config


def default_features(preset: Preset, overrides: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the features that a policy gets by default: those of the map if there is one, else of the volume."""
    mapped = configure(preset, {k: v for k, v in overrides.items() if k.startswith("mapper")}).mapper.enabled
    return ("pixel", "hole_area") if mapped else ("unknown_volume",)


def sees_colour(config: ReconstructionConfig) -> bool:
    """Return whether the observations or rewards of a learned policy depend on the colours of the scene.

    Map optimisation, tracking, revisits and some features use colours. (Revisits are chosen by rendering errors.)
    """
    mapper = config.mapper
    optimised = mapper.iterations > 0 or mapper.tracking.iterations > 0 or config.views.max_revisits > 0
    return optimised or not set(config.features) <= set(_COLOUR_BLIND)


def learning_layouts(
    world: WorldConfig, use: str, count: int, features: Sequence[str] | None = None
) -> tuple[str, ...]:
    """Return the names of ``count`` layouts for ``use`` (see `layout_specs`).

    They have no light and no textures if nothing depends on colours (`sees_colour`).
    """
    return layout_specs(use, count, world.rooms, lit=sees_colour(world_config(world, features)))


def layout_order(seed: int, count: int) -> np.ndarray:  # [count]
    """Return a random permutation of the indices of ``count`` training layouts."""
    return np.random.default_rng([seed, 0, count]).permutation(count)


def make_env(
    world: WorldConfig,
    truth: GroundTruth,
    *,
    features: Sequence[str] | None = None,
    noise: dict[str, Any] | None = None,
) -> ReconstructionEnv:
    """Make the environment of one scene; ``noise`` is a result of `draw_noise`, or None for no sensor noise.

    An episode never ends at a given coverage, since coverage is ground truth. The reward's coverage is computed without
    sensor noise. Otherwise repeated views would be rewarded as new surface: at 6 m and twice the Kinect's noise, the
    depth error is as large as the reward's tolerance.
    """
    config = replaced(world_config(world, features), {"sensor": noise or {}})
    return ReconstructionEnv(
        truth, config=config, coverage_target=None, max_planes=world.max_planes, reward={"noise_free": True}
    )


def draw_noise(rng: np.random.Generator) -> dict[str, Any]:
    """Draw the sensor noise of one episode, as fields of the sensor's configuration."""
    perfect, multiplier, holes = rng.random() < _PERFECT_SHARE, rng.uniform(*_NOISE_RANGE), rng.random() < 0.5
    if perfect:
        return {"depth_noise": "none"}
    return {"depth_noise": "kinect", "noise_multiplier": float(multiplier), "edge_dropout": bool(holes)}


def learning_reward(kind: Reward, *, share: float, frames: int, left: float, env_reward: float) -> float:
    """Return the reward of one step for PPO.

    Parameters
    ----------
    kind
        "rate": 20 share / (1 + frames / 5), like the score of greedy planners, for a short horizon. "auc": 20 share
        left, whose sum over an episode is 20 times the area under the curve of gained coverage. "env": ``env_reward``.
    share
        Share of the surface that the step showed for the first time, 0..1.
    frames
        Number of frames of the step.
    left
        Share of the frame budget that is left, 0..1, as the mean of before and after the step.
    env_reward
        Reward of the environment, whose cost is in metres instead of frames.
    """
    if kind == "rate":
        return 20.0 * share / (1.0 + frames / _RATE_FRAMES)
    if kind == "auc":
        return 20.0 * share * left
    return env_reward


class TrainingEnv(gym.Env[dict[str, Any], np.int64]):
    """Play training episodes on random layouts; observations hold only the entries that a learned policy reads.

    A reset with a seed draws a new layout, or takes layout n of ``options={"layout": n}``. A reset without a seed keeps
    the layout, since building one takes as long as several episodes. An episode whose frame budget ends counts as
    terminated and not as truncated, since the budget is part of the observation.
    """

    observation_space: spaces.Dict
    action_space: spaces.Discrete

    def __init__(self, world: WorldConfig, layouts: Sequence[str]) -> None:
        config = world_config(world)
        self.world, self.layouts = world, tuple(layouts)
        whole = observation_space(config, world.max_planes)
        self.observation_space = spaces.Dict({key: whole[key] for key in USED_KEYS})
        self.action_space = spaces.Discrete(config.views.max_candidates)
        self.env: ReconstructionEnv | None = None
        self._truth: GroundTruth | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin an episode; ``seed`` and ``options`` choose the layout as described above."""
        super().reset(seed=seed)
        observation: dict[str, np.ndarray] = {}
        drawn, attempts = int(self.np_random.integers(len(self.layouts))), 0
        if seed is not None or self._truth is None:
            self._truth = Layout(self.layouts[(options or {}).get("layout", drawn)]).truth()
        while not observation or not observation["action_mask"].any():  # without a candidate, draw another start
            if attempts and attempts % STARTS == 0:
                self._truth = Layout(self.layouts[int(self.np_random.integers(len(self.layouts)))]).truth()
            attempts += 1
            self.close()
            noise = draw_noise(self.np_random) if self.world.noise else None
            self.env = make_env(self.world, self._truth, noise=noise)
            observation, info = self.env.reset(seed=int(self.np_random.integers(2**31)))
        self._frames, self._left = info["frames"], float(observation["budget"][0])
        return self._used(observation), {"action_mask": info["action_mask"]}

    def step(self, action: Any) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Move to the candidate of row ``action``; the reward is that of `learning_reward`."""
        assert self.env is not None, "reset() comes first"
        observation, reward, terminated, truncated, info = self.env.step(action)
        frames, self._frames = info["frames"] - self._frames, info["frames"]
        before, self._left = self._left, float(observation["budget"][0])
        earned = learning_reward(
            self.world.reward,
            share=info["reward/coverage"] / self.env.reward_config.coverage,
            frames=frames,
            left=0.5 * (before + self._left),
            env_reward=reward,
        )
        return self._used(observation), earned, terminated or truncated, False, {"action_mask": info["action_mask"]}

    def close(self) -> None:
        """Close the environment of the episode."""
        if self.env is not None:
            self.env.close()

    @staticmethod
    def _used(observation: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {key: observation[key] for key in USED_KEYS}
