"""Measure the time of one decision of each policy, in the same state of an episode.

A decision consists of the candidates, the features of all candidates, and the choice.
"""

from __future__ import annotations

import copy
import dataclasses
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.bench import print_rows
from activestructure_gym.evaluation.cli.options import split_policies, split_scenes
from activestructure_gym.evaluation.cli.output import make_console
from activestructure_gym.evaluation.machine.threads import thread_cap
from activestructure_gym.specs import Spec
from activestructure_gym.streams import escape
from benchmarks.command import run

if TYPE_CHECKING:
    from activestructure_gym.config import Preset

LIMIT_S = 2.0  # limit of the seconds per decision, for policies without an entry in LIMITS_S
LIMITS_S = {"activestructure": 0.12}  # limit of the seconds per decision by policy
SCENE = "apartment?rooms=3"
_SEED = 0


def run_policy_benchmark(
    scene: str = SCENE,
    *,
    policies: Sequence[str] = (),  # empty: all registered policies
    preset: Preset = "default",
    gaussians: int = 30_000,  # the state is taken once the map has this number and the candidate table is full
    frames: int = 400,  # the state is taken after this number of frames at the latest
    repeats: int = 7,  # timed decisions per policy
    notify: Callable[[str], None] = lambda _: None,
) -> list[dict[str, Any]]:
    """Return a row per policy: median and quartiles of the seconds per decision, and the medians of its parts.

    The state is from an episode of the policy pixel_only. The parts of a decision are ``offer`` (paths, candidates and
    revisits, equal for all policies), features, and policy. Every decision is made on a fresh copy of the mapper, so
    the time includes the features' measurements of new keyframes. Policies alternate. The first round is not timed,
    since it compiles kernels. ``limit`` states whether the median is under the limit.
    """
    from activestructure_gym.policies import POLICIES

    names = list(policies or POLICIES)
    env = _explored(scene, preset, gaussians, frames, notify)
    mapper = env.reconstruction.mapper
    times: dict[str, list[dict[str, float]]] = {name: [] for name in names}
    for repeat in range(repeats + 1):
        for name in names if repeat % 2 else names[::-1]:
            notify(f"round {repeat} of {repeats}: {name}")
            env.reconstruction.mapper = copy.deepcopy(mapper)
            seconds = _decision(env, name)
            if repeat:
                times[name].append(seconds)
    reconstruction = env.reconstruction
    state = {
        "candidates": len(reconstruction.candidates),
        "gaussians": reconstruction.mapper.map.count,
        "keyframes": len(reconstruction.keyframe_indices),
        "planes": len(reconstruction.planes.nodes),
        "threads": thread_cap(),
    }
    env.close()
    return [_row(name, times[name]) | state for name in names]


def _explored(scene: str, preset: Preset, gaussians: int, frames: int, notify: Callable[[str], None]) -> Any:
    """Play an episode with the policy pixel_only until the state is reached, and return the environment.

    The state is reached when the map has ``gaussians`` Gaussians and the candidate table is full, at the latest after
    ``frames`` frames.
    """
    from activestructure_gym.envs import ReconstructionEnv
    from activestructure_gym.policies import make_policy

    policy = make_policy("pixel_only")
    env = ReconstructionEnv(
        scene=scene, preset=preset, frame_budget=frames + 1, features=policy.required_features, coverage_target=None
    )
    policy.bind(env)
    observation, _ = env.reset(seed=_SEED)
    policy.reset(_SEED)
    ended = False
    while not ended and (env.reconstruction.mapper.map.count < gaussians or not observation["action_mask"].all()):
        _update_memory(env)
        observation, _, terminated, truncated, _ = env.step(policy.act(observation))
        ended = terminated or truncated
        notify(f"exploring: {env.reconstruction.frames} frames, {env.reconstruction.mapper.map.count} Gaussians")
    return env


def _update_memory(env: Any) -> None:
    """Update the data that some features keep about keyframes (`FeatureContext.episode`), as for a real decision."""
    from activestructure_gym.features import FEATURES

    context = env.reconstruction.feature_context(np.zeros((0, 4, 4)))
    for name in ("rt_guide", "gauss_mi", "next_best_sense", "r3_recon"):
        FEATURES.get(name)(context)


def _decision(env: Any, name: str) -> dict[str, float]:
    """Time one decision of the policy ``name`` in the current state of ``env``, without a step of the environment.

    Return the wall seconds of each part, and the processor seconds of the decision. The configuration of ``env`` gets
    the features of the policy.
    """
    from activestructure_gym.envs.observation import encode
    from activestructure_gym.policies import make_policy

    policy = make_policy(name)
    reconstruction = env.reconstruction
    reconstruction.config = dataclasses.replace(reconstruction.config, features=tuple(policy.required_features))
    before, processor = dict(reconstruction.seconds), time.process_time()
    reconstruction._refresh()
    spent = {key: reconstruction.seconds[key] - before.get(key, 0.0) for key in ("planning", "features")}
    processor = time.process_time() - processor
    observation = encode(reconstruction, reconstruction.mapper.keyframes[-1], env.max_planes)
    policy.bind(reconstruction.config.features)
    policy.reset(_SEED)
    began, processor_began = time.perf_counter(), time.process_time()
    policy.act(observation)
    spent["policy"] = time.perf_counter() - began
    return spent | {"cpu": processor + time.process_time() - processor_began}


def _row(name: str, times: Sequence[dict[str, float]]) -> dict[str, Any]:
    offer, features, policy, cpu = (
        np.array([t[key] for t in times]) for key in ("planning", "features", "policy", "cpu")
    )
    decision = offer + features + policy
    limit = LIMITS_S.get(Spec(name).name, LIMIT_S)
    median = float(np.median(decision))
    return {
        "policy": name,
        "decision_s": median,
        "quartiles": tuple(float(q) for q in np.quantile(decision, [0.25, 0.75])),
        "features_s": float(np.median(features)),
        "policy_s": float(np.median(policy)),
        "offer_s": float(np.median(offer)),
        "processor_s": float(np.median(cpu)),
        "limit": f"{'under' if median <= limit else 'OVER'} {limit:g}",
    }


@dataclass(frozen=True)
class Policies:
    """Measure the seconds of a decision by each policy, in one state of an episode."""

    scenes: tuple[str, ...] = ()
    """Use these scenes, separated by commas or spaces; by default apartment?rooms=3."""
    policies: tuple[str, ...] = ()
    """Time these policies, separated by commas or spaces; by default all."""
    gaussians: int | None = None
    """Take the state when the map has this many Gaussians and 256 views are offered; by default 30,000."""
    frames: int | None = None
    """Take the state after this many frames at the latest; by default 400."""
    repeats: int | None = None
    """Time this many decisions per policy, after one that is not timed; by default 7."""
    quick: bool = False
    """Run a small version, which shows only that the benchmark works."""

    def run(self) -> int:
        """Measure, print a table, and return 0."""
        from activestructure_gym.policies import make_policy

        console = make_console()
        size: dict[str, Any] = {"preset": "fast", "frames": 25, "repeats": 1} if self.quick else {}
        given = {"gaussians": self.gaussians, "frames": self.frames, "repeats": self.repeats}
        for name, value in given.items():
            if value is not None and value < 1:
                raise InputError(f"--{name} must be at least 1, got {value}")
        size |= {name: value for name, value in given.items() if value is not None}
        names = split_policies(self.policies)
        for name in names:
            make_policy(name)  # raises InputError for an unknown name before the episode is played
        with console.status("measuring the policies") as status:
            rows = [
                row | {"scene": spec}
                for spec in split_scenes(self.scenes) or ["box" if self.quick else SCENE]
                for row in run_policy_benchmark(
                    spec, policies=names, notify=lambda line: status.update(escape(line)), **size
                )
            ]
        print_rows(console, rows, "seconds of a decision, median and quartiles")
        return 0


if __name__ == "__main__":
    sys.exit(run(Policies))
