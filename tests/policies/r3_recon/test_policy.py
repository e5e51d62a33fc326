"""R3-RECON's choice by hand: the weight of the path, and views at the agent's position."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS
from activestructure_gym.policies import POLICIES
from activestructure_gym.policies.frontier import Frontier
from activestructure_gym.policies.r3_recon import R3Recon


def observation(gains: list, losses: list, lengths: list) -> dict[str, np.ndarray]:
    table = np.zeros((len(gains), len(CANDIDATE_COLUMNS)), np.float32)
    table[:, CANDIDATE_COLUMNS.index("path_length")] = lengths
    features = np.array([gains, losses], np.float32).T
    return {"candidates": table, "candidate_features": features, "action_mask": np.ones(len(gains), np.int8)}


@pytest.fixture
def policy() -> R3Recon:
    made = R3Recon()
    made.bind(("r3_recon", "r3_recon_mean_loss"))
    return made


def test_the_largest_mean_loss_weighs_the_path(policy: R3Recon) -> None:
    step = observation([65.0, 35.0], [0.9, 0.2], [3.0, 1.0])
    assert policy.native_scores(np.array([65.0, 35.0]), step) == pytest.approx([-0.025, 0.125])
    assert policy.act(step) == 1
    assert policy.act(observation([65.0, 35.0], [0.0, 0.0], [3.0, 1.0])) == 0  # nothing is lost: the path is free


def test_a_turn_in_place_is_no_candidate_unless_there_is_no_other(policy: R3Recon) -> None:
    step = observation([0.004, 0.006], [1.0, 1.0], [0.0, 0.006])  # by its score 0.4 - 0 it would be better
    assert policy.act(step) == 1
    step["action_mask"][1] = 0
    assert policy.act(step) == 0


def test_its_settings_are_those_of_frontier() -> None:
    assert R3Recon.native_settings == Frontier.native_settings
    camera = POLICIES.get("active_gs").native_settings.changes
    assert camera == Frontier.native_settings.changes and camera["sensor.max_range"] == 5.0
