import numpy as np
import pytest
from scipy.stats import bootstrap

from activestructure_gym.evaluation.statistics import estimate, interquartile_mean, mean, stratified_draws


@pytest.mark.parametrize("statistic", [mean, interquartile_mean])
def test_with_one_scene_it_is_scipys_percentile_bootstrap(statistic):
    values = np.random.default_rng(1).normal(10.0, 2.0, 12)
    ours = estimate([values], statistic, repeats=20_000)
    theirs = bootstrap(
        (values,), lambda x, axis=-1: statistic(x, (x.shape[-1],)), method="percentile", n_resamples=20_000,
        rng=np.random.default_rng(2), vectorized=True,
    ).confidence_interval  # fmt: skip
    width = theirs.high - theirs.low
    assert abs(ours.low - theirs.low) < 0.03 * width and abs(ours.high - theirs.high) < 0.03 * width
    assert ours.low < ours.value < ours.high


def test_the_level_is_that_of_a_normal_mean():
    rng = np.random.default_rng(3)
    found = estimate([rng.normal(0.0, 1.0, 400), rng.normal(100.0, 1.0, 400)])
    # Half width of 95 %: 1.96 standard errors of the mean of two means of 400. The scenes' distance has no part in it.
    half = 1.96 * np.sqrt(2 / 400) / 2
    assert abs((found.high - found.low) / (2 * half) - 1.0) < 0.1


def test_every_scene_keeps_its_number_of_runs():
    sizes = (2, 5, 3)
    draws = stratified_draws(sizes, 200, 0)
    assert draws.shape == (200, 10)
    for low, high in ((0, 2), (2, 7), (7, 10)):
        part = draws[:, low:high]
        assert part.min() == low and part.max() == high - 1
    assert len(np.unique(draws, axis=0)) > 150


def test_equal_input_gives_equal_intervals_and_another_seed_does_not():
    strata = [np.arange(7.0), np.arange(5.0)]
    assert estimate(strata) == estimate(strata)
    assert estimate(strata).low != estimate(strata, repeats=500, seed=9).low


def test_one_run_on_a_scene_gives_no_interval():
    found = estimate([np.array([1.0, 2.0]), np.array([5.0])])
    assert found.value == 3.25 and not found.has_interval and not found.excludes(-100.0)


def test_what_an_interval_excludes():
    found = estimate([np.array([1.0, 2.0, 3.0])])
    assert found.excludes(0.0) and not found.excludes(2.0) and found.excludes(3.5)


@pytest.mark.parametrize("strata", [[], [np.zeros(0)], [np.ones(2), np.zeros(0)]])
def test_a_scene_without_runs_is_an_error(strata):
    with pytest.raises(ValueError, match="at least one run"):
        estimate(strata)
