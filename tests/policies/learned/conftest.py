"""Observations of no world: random candidates, gains and planes, of the shapes and ranges of the real ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from activestructure_gym.envs.observation import CANDIDATE_FEATURES
from activestructure_gym.planes import PLANE_FEATURE_HIGH, PLANE_FEATURE_LOW

Observation = dict[str, np.ndarray]


def random_observation(rng: np.random.Generator, rows: int, valid: int, planes: int, gains: int = 2) -> Observation:
    """``valid`` of the rows and all but one of the planes are there; empty rows are 0, as the env leaves them."""
    mask = np.zeros(rows, np.int8)
    mask[rng.permutation(rows)[:valid]] = 1
    present = np.zeros(planes, np.int8)
    present[: planes - 1] = 1
    candidates = rng.uniform(-4, 4, (rows, len(CANDIDATE_FEATURES))).astype(np.float32)
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
        "candidate_gains": rng.random((rows, gains)).astype(np.float32) * mask[:, None],
        "action_mask": mask,
        "plane_features": rng.uniform(low, high, (planes, len(low))).astype(np.float32) * present[:, None],
        "plane_mask": present,
        "plane_edges": (edges + edges.T) * linked,
        "candidate_planes": rng.integers(0, 2, (rows, planes)).astype(np.int8) * mask[:, None] * present,
    }


@pytest.fixture
def make_observation(rng: np.random.Generator) -> Callable[..., Observation]:
    """``make_observation(rows=.., valid=.., planes=..)``, another one at every call."""

    def make(rows: int = 16, valid: int = 9, planes: int = 7, gains: int = 2) -> Observation:
        return random_observation(rng, rows, valid, planes, gains)

    return make
