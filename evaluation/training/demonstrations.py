"""Collect and load demonstrations: episodes of an expert, with its scores of all candidates in every state.

The methods bc and rank learn from demonstrations. Each file holds the episodes on one layout. A file is written
atomically, so collecting can be resumed. Its content depends only on the configuration and the file's number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from activestructure_gym.envs.observation import row_columns
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.json_files import as_read, read_json, write_json
from activestructure_gym.evaluation.archive.schema import Array, Mismatch, check_arrays, table
from activestructure_gym.evaluation.training.config import WITH_TRUTH, TrainingConfig
from activestructure_gym.evaluation.training.oracle import expert_choice, expert_scores
from activestructure_gym.evaluation.training.process_pool import spread
from activestructure_gym.evaluation.training.training_env import (
    STARTS,
    draw_noise,
    layout_order,
    learning_layouts,
    learning_reward,
    make_env,
    world_config,
)
from activestructure_gym.files import replaced
from activestructure_gym.ground_truth import Layout
from activestructure_gym.npz import read_npz
from activestructure_gym.planes import PLANE_FEATURES
from activestructure_gym.policies.candidates import Candidates
from activestructure_gym.policies.learned.config import USED_KEYS

DATA = "demonstrations"
_DESCRIPTION = "demonstrations.json"
_RECORDED = ("scores", "rewards", "ends", "actions")  # arrays in addition to `USED_KEYS`


@dataclass(frozen=True)
class Demonstrations:
    """Hold the N states of all episodes, in the order in which the expert visited them."""

    observations: dict[str, np.ndarray]  # one array [N, ...] per entry of USED_KEYS
    scores: np.ndarray  # [N, K] expert's scores of K candidates, at least 0; 0 in rows without a candidate
    rewards: np.ndarray  # [N] reward of the step from this state
    ends: np.ndarray  # [N] bool: the last state of its episode
    actions: np.ndarray  # [N] int16: the row that was taken; a share ``explore`` of them is random

    def __len__(self) -> int:
        return len(self.scores)

    def returns(self, gamma: float) -> np.ndarray:  # [N]
        """Return, for every state, the sum of rewards to the end of its episode, discounted by ``gamma`` per step."""
        result, following = np.zeros(len(self.rewards)), 0.0
        for n in range(len(self.rewards) - 1, -1, -1):
            following = self.rewards[n] + gamma * (0.0 if self.ends[n] else following)
            result[n] = following
        return result


def description(config: TrainingConfig) -> dict[str, Any]:
    """Return the settings of a training run on which its demonstrations depend."""
    whole = config.as_dict()
    return {key: whole[key] for key in ("seed", "world", "teacher", "episodes", "explore")}


def missing_files(config: TrainingConfig, directory: Path) -> list[int]:
    """Return the numbers of the files of demonstrations that ``directory`` lacks."""
    numbers = range(-(-config.episodes // config.world.episodes_per_layout))
    return [number for number in numbers if not _file(directory, number).is_file()]


def collect(
    config: TrainingConfig, directory: Path, *, workers: int = 1, notify: Callable[[int, int], None] = lambda *_: None
) -> int:
    """Play the episodes whose files ``directory`` lacks, write these files, and return their number.

    ``workers`` is the number of processes. ``notify`` is called with the number of existing files and the number of all
    files. Raise `InputError` if the directory holds demonstrations of other settings.
    """
    directory.mkdir(parents=True, exist_ok=True)
    check_description(config, directory)
    write_json(directory / _DESCRIPTION, description(config))
    missing, total = missing_files(config, directory), -(-config.episodes // config.world.episodes_per_layout)
    notify(total - len(missing), total)
    for done in spread(_write, [(config, directory, number) for number in missing], workers):
        notify(total - len(missing) + done, total)
    return len(missing)


def check_description(config: TrainingConfig, directory: Path) -> None:
    """Raise `InputError` if ``directory`` holds demonstrations of other settings."""
    if not (directory / _DESCRIPTION).is_file():
        return
    file = directory / _DESCRIPTION
    found = read_json(file, table(), remedy=f"delete '{directory}', and its episodes are played again")
    wanted = as_read(description(config))
    different = [key for key in wanted if found.get(key) != wanted[key]]
    if different:
        raise InputError(
            f"'{directory}' holds demonstrations made with another {' and '.join(different)}: choose another directory"
        )


def load(config: TrainingConfig, directory: Path) -> Demonstrations:
    """Load all demonstrations; raise `InputError` if a file is missing, damaged or of other settings."""
    check_description(config, directory)
    missing, numbers = missing_files(config, directory), range(-(-config.episodes // config.world.episodes_per_layout))
    if missing:
        raise InputError(f"'{directory}' lacks {len(missing)} of {len(numbers)} files of demonstrations")
    files = [_read(_file(directory, number), config) for number in numbers]
    if len({tuple(file["candidates"].shape[1:]) for file in files}) > 1:
        raise InputError(f"'{directory}' holds demonstrations with tables of different sizes: choose another directory")
    joined = {key: np.concatenate([file[key] for file in files]) for key in files[0]}
    observations = {key: joined.pop(key) for key in USED_KEYS}
    return Demonstrations(observations, **joined)


def _read(file: Path, config: TrainingConfig) -> dict[str, np.ndarray]:
    """Return the arrays of a file by name; raise `InputError` if their names, shapes or types are wrong."""
    try:
        arrays = read_npz(file)
        check_arrays(arrays, _layout(config))
        if not arrays["action_mask"].any(axis=1).all() or not arrays["ends"][-1]:
            raise Mismatch("it does not hold whole episodes")
    except (OSError, ValueError) as error:
        raise InputError(f"'{file}' is damaged: {error}; delete it, and its episodes are played again") from error
    return {name: arrays[name] for name in (*USED_KEYS, *_RECORDED)}


def _layout(config: TrainingConfig) -> dict[str, Array]:
    """Return the expected shapes and types of the arrays in a file of demonstrations, by name.

    N is the number of states, and K the number of rows of the candidate table.
    """
    planes, features, columns = config.world.max_planes, len(config.network().features), len(PLANE_FEATURES)
    candidate = len(row_columns(world_config(config.world).views.stages))
    shapes: dict[str, tuple[int | str, ...]] = {
        "pose": (7,), "budget": (1,), "candidates": ("K", candidate),
        "candidate_features": ("K", features), "action_mask": ("K",), "plane_features": (planes, columns),
        "plane_mask": (planes,), "plane_edges": (planes, planes), "candidate_planes": ("K", planes), "scores": ("K",),
        "rewards": (),
    }  # fmt: skip
    dtypes = {"action_mask": "i1", "plane_mask": "i1", "candidate_planes": "i1", "rewards": "f8"}
    layout = {name: Array(dtypes.get(name, "f4"), ("N", *shape), least=1) for name, shape in shapes.items()}
    return layout | {"ends": Array("b1", ("N",), least=1), "actions": Array("i2", ("N",), low=0, least=1)}


def record(config: TrainingConfig, number: int) -> dict[str, np.ndarray]:
    """Play the episodes of file ``number``, which are on one layout, and return the file's arrays by name."""
    world = config.world
    extra = () if config.teacher in WITH_TRUTH else (config.teacher,)
    layouts = learning_layouts(world, "train", world.layouts, (*world.features, *extra))
    rng = np.random.default_rng([config.seed, number])
    truth = Layout(layouts[layout_order(config.seed, len(layouts))[number % len(layouts)]]).truth()
    columns: dict[str, list[Any]] = {key: [] for key in (*USED_KEYS, *_RECORDED)}
    first = number * world.episodes_per_layout
    for _ in range(first, min(first + world.episodes_per_layout, config.episodes)):
        noise = draw_noise(rng) if world.noise else None
        env = make_env(world, truth, features=(*world.features, *extra), noise=noise)
        for state in _episode(config, env, rng):
            for key, value in state.items():
                columns[key].append(value)
        env.close()
    if not columns["ends"]:
        raise InputError(
            f"'{truth.scene.name}' offers no view from any of {STARTS} starts: use other --rooms, or fewer --layouts"
        )
    return {key: np.stack(values) for key, values in columns.items()}


def _episode(config: TrainingConfig, env: Any, rng: np.random.Generator) -> Iterator[dict[str, Any]]:
    observation, info = env.reset(seed=int(rng.integers(2**31)))
    columns = config.network().features
    for _ in range(STARTS):
        if observation["action_mask"].any():
            break
        observation, info = env.reset(seed=int(rng.integers(2**31)))
    ended = not observation["action_mask"].any()
    while not ended:
        scores = expert_scores(config.teacher, env, observation)
        valid = np.flatnonzero(observation["action_mask"])
        explores, drawn = rng.random() < config.explore, int(rng.choice(valid))
        action = drawn if explores else expert_choice(scores, observation)
        state = {key: observation[key] for key in USED_KEYS}
        candidates = Candidates(observation, env.config.features)
        state["candidate_features"] = np.stack([candidates[name] for name in columns], axis=1)
        before, left = info["frames"], float(observation["budget"][0])
        observation, reward, terminated, truncated, info = env.step(action)
        ended = terminated or truncated
        earned = learning_reward(
            config.world.reward,
            share=info["reward/coverage"] / env.reward_config.coverage,
            frames=info["frames"] - before,
            left=0.5 * (left + float(observation["budget"][0])),
            env_reward=reward,
        )
        yield state | {
            "scores": scores.astype(np.float32), "rewards": earned, "ends": ended, "actions": np.int16(action),
        }  # fmt: skip


def _write(config: TrainingConfig, directory: Path, number: int) -> None:
    file = _file(directory, number)
    with replaced(file) as stream:
        np.savez_compressed(stream, **record(config, number))  # type: ignore[arg-type]


def _file(directory: Path, number: int) -> Path:
    return directory / f"layout-{number:05d}.npz"
