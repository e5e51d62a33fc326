import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from activestructure_gym.evaluation.statistics import probability_of_improvement, win_share


def test_it_is_mann_and_whitneys_u_over_the_number_of_pairs():
    rng = np.random.default_rng(0)
    ours, theirs = rng.integers(0, 5, 9).astype(float), rng.integers(0, 5, 6).astype(float)  # with ties
    u = mannwhitneyu(ours, theirs).statistic
    assert np.isclose(win_share(ours, theirs).mean(), u / (9 * 6))


def test_both_sides_add_up_to_one():
    rng = np.random.default_rng(1)
    ours = [rng.integers(0, 4, 5).astype(float) for _ in range(3)]
    theirs = [rng.integers(0, 4, 4).astype(float) for _ in range(3)]
    there, back = probability_of_improvement(ours, theirs), probability_of_improvement(theirs, ours)
    assert np.isclose(there + back, 1.0)


def test_worked_by_hand():
    # Scene 1: 3 > 1, 3 > 2, 2 > 1, 2 = 2: 3.5 of 4. Scene 2: 0 of 4.
    found = probability_of_improvement(
        [np.array([3.0, 2.0]), np.array([0.0, 0.0])], [np.array([1.0, 2.0]), np.array([5.0, 6.0])]
    )
    assert found == 3.5 / 4 / 2


def test_without_overlap_it_is_certain():
    assert probability_of_improvement([np.array([5.0, 6.0])], [np.array([1.0])]) == 1.0


def test_scenes_must_match():
    with pytest.raises(ValueError, match="same scenes"):
        probability_of_improvement([np.ones(2)], [])
