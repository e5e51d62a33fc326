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
    assert np.isclose(there.value + back.value, 1.0)


def test_worked_by_hand():
    # Scene 1: 3 > 1, 3 > 2, 2 > 1, 2 = 2: 3.5 of 4. Scene 2: 0 of 4.
    found = probability_of_improvement(
        [np.array([3.0, 2.0]), np.array([0.0, 0.0])], [np.array([1.0, 2.0]), np.array([5.0, 6.0])]
    )
    assert found.value == 3.5 / 4 / 2
    # Scene 2 is 0 in every resample, scene 1 between 1/2 (only the twos drawn) and 1.
    assert 0.25 <= found.low <= found.value <= found.high <= 0.5


def test_the_interval_is_that_of_a_bootstrap_with_indices():
    rng = np.random.default_rng(4)
    ours, theirs = rng.normal(0.5, 1.0, 10), rng.normal(0.0, 1.0, 8)
    found = probability_of_improvement([ours], [theirs], repeats=20_000)
    drawn = [win_share(rng.choice(ours, 10), rng.choice(theirs, 8)).mean() for _ in range(4000)]
    np.testing.assert_allclose([found.low, found.high], np.percentile(drawn, [2.5, 97.5]), atol=0.02)


def test_without_overlap_it_is_certain_and_with_one_run_it_has_no_interval():
    high, low = np.array([5.0, 6.0]), np.array([1.0, 2.0])
    sure = probability_of_improvement([high], [low])
    assert (sure.value, sure.low, sure.high) == (1.0, 1.0, 1.0)
    assert not probability_of_improvement([high[:1]], [low]).has_interval


def test_scenes_must_match():
    with pytest.raises(ValueError, match="same scenes"):
        probability_of_improvement([np.ones(2)], [])


def test_weights_of_resamples_are_those_of_a_generator_of_their_own():
    rng = np.random.default_rng(5)
    strata = [[rng.normal(size=n) for n in sizes] for sizes in ((3, 4), (2, 5))]
    ours, theirs = ([pair[side] for pair in strata] for side in (0, 1))
    fresh, total = np.random.default_rng(0), np.zeros(5000)
    for x, y in strata:
        a, b = (fresh.multinomial(len(z), np.full(len(z), 1 / len(z)), 5000) / len(z) for z in (x, y))
        total += np.einsum("rn,nm,rm->r", a, win_share(x, y), b) / 2
    for _ in range(2):  # kept draws are those of the first time
        found = probability_of_improvement(ours, theirs)
        np.testing.assert_allclose([found.low, found.high], np.percentile(total, [2.5, 97.5]), atol=1e-12)
