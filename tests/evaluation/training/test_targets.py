"""Labels by hand."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from activestructure_gym.evaluation.training.demonstrations import Demonstrations
from activestructure_gym.evaluation.training.rollout import Played, normalised
from activestructure_gym.evaluation.training.supervised import OrdinalRanks
from activestructure_gym.evaluation.training.targets import bin_edges, ordinal, soft_labels, standardised
from activestructure_gym.evaluation.training.training_env import learning_reward


def test_soft_labels_by_hand() -> None:
    scores = np.array([[2.0, 1.0, 9.0], [0.0, 0.0, 5.0], [3.0, 0.0, 0.0]])
    valid = np.array([[True, True, False], [True, True, False], [True, False, False]])
    labels = soft_labels(scores, valid, temperature=0.5)
    e = np.exp(-1.0)  # half of the best, at a temperature of half of the best
    np.testing.assert_allclose(labels, [[1 / (1 + e), e / (1 + e), 0], [0.5, 0.5, 0], [1, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(soft_labels(1000 * scores, valid, 0.5), labels)  # the scale of a state says nothing


def test_standardised_within_a_state() -> None:
    valid = np.array([[True, True, False], [True, True, True]])
    found = standardised(np.array([[1.0, 3.0, 99.0], [4.0, 4.0, 4.0]]), valid)
    np.testing.assert_allclose(found, [[-1, 1, 0], [0, 0, 0]])


def test_bins_have_equal_mass_and_keep_the_order(rng: np.random.Generator) -> None:
    values = rng.normal(size=3000)
    ranks = ordinal(values, bin_edges(values, 15))
    assert np.bincount(ranks).tolist() == [200] * 15
    order = np.argsort(values)
    assert (np.diff(ranks[order]) >= 0).all()
    tied = ordinal(np.zeros(10), bin_edges(np.zeros(10), 15))
    assert len(set(tied.tolist())) == 1


def test_ordinal_loss_by_hand_and_at_its_beginning() -> None:
    ranks = OrdinalRanks(3)
    np.testing.assert_allclose(ranks.thresholds.detach(), [np.log(2), -np.log(2)], atol=1e-6)  # P = 2/3, 1/3
    loss = ranks(torch.tensor([0.0]), torch.tensor([1]))  # above the first border, below the second
    assert float(loss.detach()) == pytest.approx(-2 * np.log(2 / 3), abs=1e-6)
    right, wrong = (ranks(torch.tensor([s, -s]), torch.tensor([2, 0])).detach() for s in (2.0, -2.0))
    assert right < wrong


def test_returns_stop_at_the_end_of_an_episode() -> None:
    rewards, ends = np.array([1.0, 2.0, 4.0, 8.0]), np.array([False, True, False, True])
    data = Demonstrations({}, np.zeros((4, 1)), rewards, ends, np.zeros(4, np.int16))
    assert data.returns(0.5).tolist() == [2.0, 2.0, 8.0, 8.0]


def test_rewards_by_hand() -> None:
    given = {"share": 0.1, "frames": 5, "left": 0.25, "env_reward": 1.5}
    assert learning_reward("rate", **given) == pytest.approx(1.0)
    assert learning_reward("auc", **given) == pytest.approx(0.5)
    assert learning_reward("env", **given) == 1.5


def test_rewards_auc_sum_to_the_area_that_is_scored() -> None:
    frames, coverage, budget = (1, 4, 6, 11), (0.2, 0.4, 0.5, 0.9), 11
    earned = 0.0
    for n in range(1, len(frames)):
        left = 0.5 * sum((budget - frames[k]) / budget for k in (n - 1, n))
        earned += learning_reward("auc", share=coverage[n] - coverage[n - 1], frames=1, left=left, env_reward=0.0)
    area = Played(frames=frames, coverage=coverage, budget=budget).auc - 0.2
    assert earned == pytest.approx(20 * area)


def test_area_and_normalisation_by_hand() -> None:
    played = Played(frames=(1, 6, 11), coverage=(0.2, 0.4, 0.8), budget=10)
    # 0.2 to frame 1; 0.2..0.4 over 5 frames; 0.4..0.72 over 4 frames, of 10
    assert played.auc == pytest.approx((0.2 + 5 * 0.3 + 4 * 0.56) / 10)
    assert normalised([0.5, 0.7], random=[0.2, 0.4], oracle=[0.8, 1.0]) == pytest.approx(0.5)
    assert np.isnan(normalised([1.0], random=[0.5], oracle=[0.5]))
