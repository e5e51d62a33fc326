"""Measure the environment's steps per second in one and in two processes, and the time of a step by stage."""

from __future__ import annotations

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
from activestructure_gym.evaluation.machine.threads import single_threaded_children

if TYPE_CHECKING:
    from activestructure_gym.config import Preset

SCENES = ("apartment?rooms=3",)
FEATURES = ("pixel", "hole_area")  # computed for every candidate, as by default for a learned policy
STAGES = ("sensor", "volume", "mapping", "planes", "planning", "features")  # timed stages of a step


@dataclass(frozen=True)
class Round:
    """Hold the measurements of one process in one timed round of environment steps."""

    wall: np.ndarray  # [steps] wall time in seconds
    processor: np.ndarray  # [steps] processor time in seconds
    frames: int  # number of frames taken in all steps
    keyframes: int  # number of frames that became keyframes
    stages: dict[str, float]  # wall time in seconds by stage, summed over the steps
    resets: np.ndarray  # [episodes] processor time of each reset in seconds


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
    """Measure the environment's speed, and return two lists: rows of speed, and rows of time by stage (`_profile`).

    One and two processes alternate for ``rounds`` rounds of ``seconds`` each; every process has one thread. The action
    is the candidate view with the largest "hole_area", discounted by travel; every fourth action is random. ``preset``
    and ``overrides`` configure the environment. A row of speed holds, for a scene and a number of processes:

    - ``steps_per_s``: median over the rounds, with ``range`` (minimum, maximum)
    - ``per_processor_s``: steps per second of processor time, which hardly depends on the load by other programs
    - ``times_one``: steps per second relative to one process, median over the rounds
    - ``frames_per_step``, ``keyframes_per_step``: means
    - ``reset_ms``: median processor time of a reset
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
    """Return one row per stage of a step, with its share of the wall time and its processor time in ms.

    ``parts`` are the rounds of one process. The processor time of a stage is the processor time of a step times the
    stage's share of the wall time. The row "reward, encoding" is the time in none of `STAGES`; the row "step" is the
    whole step.
    """
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
    """Control a spawned process that plays a timed round of the environment after each `begin`."""

    def __init__(self, scene: str, preset: Preset, overrides: dict[str, Any], seed: int) -> None:
        context = get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, scene, preset, overrides, seed), daemon=True)
        with single_threaded_children():
            self._process.start()
        theirs.close()

    def __enter__(self) -> _Player:
        answer = self._pipe.recv()  # waits for a first episode, which is not timed: it loads kernels and scene
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
    """Play timed episodes of the environment one after the other; each starts with another seed."""

    def __init__(self, scene: str, preset: Preset, overrides: Mapping[str, Any], seed: int) -> None:
        from activestructure_gym.envs import ReconstructionEnv

        config = {"features": FEATURES, **overrides}
        self._env = ReconstructionEnv(scene, preset=preset, config=config, coverage_target=None)
        self._column = self._env.config.features.index("hole_area")
        self._seed, self._rng = seed, np.random.default_rng(seed)

    def episode(self, until: float = np.inf) -> Round:
        """Play and measure one episode; end it early when `time.perf_counter` reaches ``until`` (seconds)."""
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
        """Play episodes for ``seconds`` and return their measurements as one `Round`."""
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
