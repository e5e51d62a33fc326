"""Observations of no world: random candidates, features and planes, of the shapes and ranges of the real ones."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS, Table
from activestructure_gym.planes import PLANE_FEATURE_HIGH, PLANE_FEATURE_LOW

Observation = dict[str, np.ndarray]
FEATURES = ("pixel", "hole_area")


def random_observation(rng: np.random.Generator, rows: int, valid: int, planes: int, features: int = 2) -> Observation:
    """``valid`` of the rows and all but one of the planes are there; empty rows are 0, as the env leaves them."""
    mask = np.zeros(rows, np.int8)
    mask[rng.permutation(rows)[:valid]] = 1
    present = np.zeros(planes, np.int8)
    present[: planes - 1] = 1
    candidates = rng.uniform(-4, 4, (rows, len(CANDIDATE_COLUMNS))).astype(np.float32)
    candidates[:, 3:6] /= np.linalg.norm(candidates[:, 3:6], axis=1, keepdims=True)
    candidates[:, 6:8] = np.abs(candidates[:, 6:8]) * 5
    candidates[:, 8] = rng.integers(0, 2, rows)
    edges = np.triu(rng.uniform(0.1, 1, (planes, planes)) * (rng.random((planes, planes)) < 0.4), 1).astype(np.float32)
    linked = np.outer(present, present)
    low, high = np.maximum(PLANE_FEATURE_LOW, -4), np.minimum(PLANE_FEATURE_HIGH, 30)
    quaternion = rng.normal(size=4)
    return {
        "pose": np.concatenate([rng.uniform(-2, 2, 3), quaternion / np.linalg.norm(quaternion)]).astype(np.float32),
        "budget": rng.random(1).astype(np.float32),
        "candidates": candidates * mask[:, None],
        "candidate_features": rng.random((rows, features)).astype(np.float32) * mask[:, None],
        "action_mask": mask,
        "plane_features": rng.uniform(low, high, (planes, len(low))).astype(np.float32) * present[:, None],
        "plane_mask": present,
        "plane_edges": (edges + edges.T) * linked,
        "candidate_planes": rng.integers(0, 2, (rows, planes)).astype(np.int8) * mask[:, None] * present,
    }


class RandomCandidates(gym.Env[dict[str, Any], np.int64]):
    """Random observations; one unit of reward for the largest first gain; a masked row ends everything."""

    def __init__(self, rows: int = 16, planes: int = 7, images: bool = False) -> None:
        self.rows, self.planes, self.images, self.steps = rows, planes, images, 0
        example = random_observation(np.random.default_rng(0), rows, rows, planes)
        self.observation_space = spaces.Dict(
            {key: spaces.Box(-1e4, 1e7, value.shape, np.float32) for key, value in example.items()}
            | {"candidate_features": Table(FEATURES, np.zeros((rows, 2), np.float32), np.ones((rows, 2), np.float32))}
            | ({"rgb": spaces.Box(0, 255, (4, 6, 3), np.uint8)} if images else {})
        )
        self.action_space = spaces.Discrete(len(example["action_mask"]))

    def _observe(self) -> dict[str, Any]:
        valid = int(self.np_random.integers(1, self.rows))
        self.last = random_observation(self.np_random, self.rows, valid, self.planes)
        images = {"rgb": np.zeros((4, 6, 3), np.uint8)} if self.images else {}
        return {key: value.astype(np.float32) for key, value in self.last.items()} | images

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict[str, Any], dict]:
        super().reset(seed=seed)
        self.steps = 0
        return self._observe(), {}

    def action_masks(self) -> np.ndarray:  # [K] bool
        return self.last["action_mask"] == 1

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict]:
        assert self.last["action_mask"][action] == 1, "a masked row"
        features = np.where(self.last["action_mask"], self.last["candidate_features"][:, 0], -1)
        self.steps += 1
        return self._observe(), float(action == features.argmax()), False, self.steps >= 5, {}
