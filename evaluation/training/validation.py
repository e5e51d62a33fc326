"""Score a network on validation layouts, relative to random choice and to the one-step oracle."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.evaluation.archive import schema
from activestructure_gym.evaluation.archive.json_files import read_json, write_json
from activestructure_gym.evaluation.training.config import TrainingConfig
from activestructure_gym.evaluation.training.rollout import Choose, normalised, play, play_oracle, play_policy
from activestructure_gym.evaluation.training.runs import SCORE
from activestructure_gym.evaluation.training.training_env import learning_layouts, make_env
from activestructure_gym.ground_truth import GroundTruth, Layout
from activestructure_gym.policies.base import best_valid
from activestructure_gym.policies.learned.config import USED_KEYS
from activestructure_gym.policies.learned.network import CandidateNetwork, as_tensors
from activestructure_gym.policies.random import Random

_SEED = 1000  # seed of the first layout's episode; layout n has the seed 1000 + n, and so another start pose
_FILE = "references.json"
_PLAYED = {name: schema.each(schema.number(0, 1)) for name in ("random", "oracle")}


def network_choice(network: CandidateNetwork) -> Choose:
    """Return a function that chooses the candidate with the network's highest score.

    The features of the environment must be those of the network, in the same order.
    """

    def choose(env: ReconstructionEnv, observation: dict[str, np.ndarray]) -> int:
        with torch.no_grad():
            scores = network(as_tensors({key: observation[key][None] for key in USED_KEYS}))[0][0]
        return best_valid(scores.numpy(), observation)

    return choose


class Validation:
    """Score a network by one episode on each validation layout, relative to two references.

    The references are random choice and the one-step oracle. They are played once per training run, and their scores
    are stored in ``references.json``. The layouts stay in memory.
    """

    def __init__(self, config: TrainingConfig, directory: Path, notify: Callable[[str], None] = lambda _: None) -> None:
        self._config, self._file, self._notify = config, directory / _FILE, notify
        self._specs = learning_layouts(config.world, "validation", config.validation_layouts)
        self._truths: list[GroundTruth] = []
        self._references: dict[str, list[float]] = {}

    def __call__(self, network: CandidateNetwork) -> dict[str, float]:
        """Return ``validation/auc``, the mean area under the coverage curve, and ``validation/normalised``.

        The latter is (auc - random) / (oracle - random), with the mean areas of the references.
        """
        self._prepare()
        areas = []
        for number, truth in enumerate(self._truths):
            self._notify(f"validating on layout {number + 1} of {len(self._truths)}")
            areas.append(play(make_env(self._config.world, truth), network_choice(network), _SEED + number).auc)
        random, oracle = self._references["random"], self._references["oracle"]
        return {SCORE: float(np.mean(areas)), "validation/normalised": normalised(areas, random, oracle)}

    def _prepare(self) -> None:
        if self._truths:
            return
        for number, spec in enumerate(self._specs):
            self._notify(f"preparing validation layout {number + 1} of {len(self._specs)}")
            self._truths.append(Layout(spec).truth())
        stored: dict[str, Any] = {}
        if self._file.is_file():
            again = "delete it, and the references are played again"
            stored = read_json(self._file, schema.table({"layouts": schema.each(schema.text)} | _PLAYED), remedy=again)
        if stored.get("layouts") != list(self._specs) or any(len(stored[name]) != len(self._specs) for name in _PLAYED):
            stored = {"layouts": list(self._specs), "random": [], "oracle": []}
            world = self._config.world
            for number, truth in enumerate(self._truths):
                self._notify(f"playing the references on layout {number + 1} of {len(self._specs)}")
                stored["random"].append(play_policy(world, truth, Random(), _SEED + number).auc)
                stored["oracle"].append(play_oracle(world, truth, _SEED + number).auc)
            write_json(self._file, stored)
        self._references = stored
