"""MAGICIAN: what it chooses where no plan reaches imagined surface."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS
from activestructure_gym.policies import make_policy


@pytest.mark.parametrize(
    ("plan", "view", "choice"),
    [
        ([0.0, 3.0, 2.0], [0.0, 1.0, 2.0], 1),
        ([0.0, 0.0, 0.0], [0.0, 0.0, 2.0], 2),  # more than 50 frames away
        ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0], 0),  # the nearest
    ],
)
def test_surface_beyond_the_reach_of_plans_is_better_than_the_nearest_view(
    plan: list[float], view: list[float], choice: int
) -> None:
    policy = make_policy("magician")
    policy.bind(("magician_plan", "magician_view"))
    table = np.zeros((3, len(CANDIDATE_COLUMNS)), np.float32)
    table[:, CANDIDATE_COLUMNS.index("frames")] = table[:, CANDIDATE_COLUMNS.index("path_length")] = [2.0, 4.0, 60.0]
    observation = {
        "candidates": table,
        "candidate_features": np.array([plan, view], np.float32).T,
        "action_mask": np.ones(3, np.int8),
        "pose": np.array([9, 9, 9, 1, 0, 0, 0], np.float32),
    }
    assert policy.act(observation) == choice
