"""Measure the steps per second of the environment in one and two processes, and the time of a step by stage."""

from __future__ import annotations

import os
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.machine.threads import capped_environment

if TYPE_CHECKING:
    from activestructure_gym.config import Preset

SCENES = ("apartment?rooms=3",)
FEATURES = ("pixel", "hole_area")  # default features of a learned policy
STAGES = ("sensor", "volume", "mapping", "planes", "planning", "features")


@dataclass(frozen=True)
class Round:
    """Hold times, frames and stages of the steps of one process in one timed round, and the times of its resets."""

    wall: np.ndarray  # [steps] seconds
    processor: np.ndarray  # [steps] seconds
    frames: int
    keyframes: int
    stages: dict[str, float]  # seconds of wall time
    resets: np.ndarray  # [episodes] seconds of processor time


def run_env_benchmark(
    scenes: Sequence[str] = SCENES,
    *,
    preset: Preset = "fast",
    overrides: Mapping[str, Any] | None = None,
    rounds: int = 5,
    seconds: float = 6.0,
    seed: int = 0,
    notify: Callable[[str], None] = lambda line: None,
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return rows of speed and rows of stages. One and two processes alternate, for ``rounds`` of ``seconds`` each.

    The action is the view with the most `hole_area` per frame, and every fourth action is random. Every process has one
    thread. Steps per second are medians over the rounds, with minimum and maximum as ``range``. ``per_processor_s``
    does not depend on the load by other programs.
    """
    speed, profile = [], []
    for scene in scenes:
        with ExitStack() as stack:
            players = [stack.enter_context(_Player(scene, preset, dict(overrides or {}), seed + n)) for n in range(2)]
            notify(f"environment on {scene}")
            done: dict[int, list[list[Round]]] = {1: [], 2: []}
            for _ in range(rounds):
                for count in (1, 2):
                    for player in players[:count]:
                        player.begin(seconds)
                    done[count].append([player.result() for player in players[:count]])
        one = [_per_second(parts) for parts in done[1]]
        for count in (1, 2):
            rates, parts = [_per_second(parts) for parts in done[count]], sum(done[count], [])
            steps = sum(len(part.wall) for part in parts)
            speed.append({
                "scene": scene, "processes": count, "steps": steps,
                "steps_per_s": float(np.median(rates)), "range": (min(rates), max(rates)),
                "per_processor_s": count * steps / sum(float(part.processor.sum()) for part in parts),
                "times_one": float(np.median([two / first for two, first in zip(rates, one)])),
                "frames_per_step": sum(part.frames for part in parts) / steps,
                "keyframes_per_step": sum(part.keyframes for part in parts) / steps,
                "reset_ms": 1e3 * float(np.median(np.concatenate([part.resets for part in parts]))),
            })  # fmt: skip
        profile += _profile(scene, sum(done[1], []))
    return speed, profile


def _per_second(parts: Sequence[Round]) -> float:
    return sum(len(part.wall) / float(part.wall.sum()) for part in parts)


def _profile(scene: str, parts: Sequence[Round]) -> list[dict[str, Any]]:
    """Return processor ms per step and stage: the processor time of a step times the stage's share of wall time."""
    steps = sum(len(part.wall) for part in parts)
    wall, processor = (float(sum(getattr(part, name).sum() for part in parts)) for name in ("wall", "processor"))
    spent = {stage: sum(part.stages.get(stage, 0.0) for part in parts) / wall for stage in STAGES}
    spent["reward, encoding"] = 1.0 - sum(spent.values())
    rows = [
        {"scene": scene, "stage": stage, "ms_per_step": 1e3 * share * processor / steps, "share": share}
        for stage, share in spent.items()
    ]
    return [*rows, {"scene": scene, "stage": "step", "ms_per_step": 1e3 * processor / steps, "share": 1.0}]


class _Player:
    """Hold a spawned process that plays timed rounds on request."""

    def __init__(self, scene: str, preset: Preset, overrides: dict[str, Any], seed: int) -> None:
        context = get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, scene, preset, overrides, seed), daemon=True)
        before = dict(os.environ)
        os.environ.update(capped_environment(1))  # libraries read the number of threads when they are imported
        try:
            self._process.start()
        finally:
            os.environ.clear()
            os.environ.update(before)
        theirs.close()

    def __enter__(self) -> _Player:
        answer = self._pipe.recv()  # sent after a first episode, which loads kernels and scene
        if isinstance(answer, InputError):
            raise answer
        return self

    def begin(self, seconds: float) -> None:
        self._pipe.send(seconds)

    def result(self) -> Round:
        result = self._pipe.recv()
        assert isinstance(result, Round)
        return result

    def __exit__(self, *_: object) -> None:
        self._pipe.close()
        self._process.join(10)
        if self._process.is_alive():
            self._process.kill()


def _serve(pipe: Connection, scene: str, preset: Preset, overrides: dict[str, Any], seed: int) -> None:
    try:
        play = Episodes(scene, preset, overrides, seed)
        play.episode()
    except InputError as error:
        pipe.send(error)
        return
    pipe.send("ready")
    while True:
        try:
            seconds = pipe.recv()
        except EOFError:
            return
        pipe.send(play.during(seconds))


class Episodes:
    """Play timed episodes one after the other."""

    def __init__(self, scene: str, preset: Preset, overrides: Mapping[str, Any], seed: int) -> None:
        from activestructure_gym.envs import ReconstructionEnv

        config = {"features": FEATURES, **overrides}
        self._env = ReconstructionEnv(scene, preset=preset, config=config, coverage_target=None)
        self._column = self._env.config.features.index("hole_area")
        self._seed, self._rng = seed, np.random.default_rng(seed)

    def episode(self, until: float = np.inf) -> Round:
        """Play one episode, or its part until the time ``until`` of `time.perf_counter`."""
        from activestructure_gym.policies import travel_discount

        began = time.process_time()
        observation, info = self._env.reset(seed=self._seed)
        self._seed += 1_000
        reset, stages = time.process_time() - began, self._env.reconstruction.seconds
        stages.clear()
        first = info["frames"], info["keyframes"]
        wall, processor, ended = list[float](), list[float](), False
        while not ended and (not wall or time.perf_counter() < until):
            valid = observation["action_mask"].astype(bool)
            scores = observation["candidate_features"][:, self._column] * travel_discount(observation)
            if len(wall) % 4 == 3:
                scores = self._rng.random(len(valid))
            action = int(np.argmax(np.where(valid, scores, -1.0)))
            starts = time.perf_counter(), time.process_time()
            observation, _, terminated, truncated, info = self._env.step(action)
            wall.append(time.perf_counter() - starts[0])
            processor.append(time.process_time() - starts[1])
            ended = terminated or truncated
        return Round(
            np.array(wall), np.array(processor), info["frames"] - first[0], info["keyframes"] - first[1], dict(stages),
            np.array([reset]),
        )  # fmt: skip

    def during(self, seconds: float) -> Round:
        """Play episodes for ``seconds`` and return their sums."""
        until, parts = time.perf_counter() + seconds, list[Round]()
        while not parts or time.perf_counter() < until:
            parts.append(self.episode(until))
        stages: defaultdict[str, float] = defaultdict(float)
        for part in parts:
            for stage, spent in part.stages.items():
                stages[stage] += spent
        wall, processor, resets = (
            np.concatenate([getattr(part, name) for part in parts]) for name in ("wall", "processor", "resets")
        )
        frames, keyframes = (sum(getattr(part, name) for part in parts) for name in ("frames", "keyframes"))
        return Round(wall, processor, frames, keyframes, dict(stages), resets)
