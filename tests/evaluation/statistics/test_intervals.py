import numpy as np
import pytest
from scipy import stats

from activestructure_gym.evaluation.statistics import (
    degrees_of_freedom,
    estimate,
    interquartile_mean,
    mean,
    median,
    standard_error,
    stratified_draws,
)


def half_width(values, sizes, statistic=mean):
    freedom = degrees_of_freedom(values, sizes, statistic)
    return stats.t.ppf(0.975, freedom) * standard_error(values, sizes, statistic)


@pytest.mark.parametrize("count", [2, 3, 12])
def test_with_one_scene_it_is_scipys_t_interval(count):
    values = np.random.default_rng(1).normal(10.0, 2.0, count)
    found, theirs = estimate([values]), stats.ttest_1samp(values, 0.0).confidence_interval()
    np.testing.assert_allclose([found.low, found.high], [theirs.low, theirs.high])
    assert found.low < found.value < found.high


def test_with_two_scenes_it_is_scipys_welch_interval():
    rng = np.random.default_rng(2)
    first, second = rng.normal(3.0, 1.0, 4), rng.normal(7.0, 5.0, 9)
    # The mean of the two scene means is half the difference between the first and the negative of the second.
    theirs = stats.ttest_ind(first, -second, equal_var=False).confidence_interval()
    found = estimate([first, second])
    np.testing.assert_allclose([found.low, found.high], [theirs.low / 2, theirs.high / 2])


@pytest.mark.parametrize(("scenes", "runs"), [(1, 3), (2, 3), (6, 2), (6, 3), (6, 5)])
@pytest.mark.parametrize("spread", [0.0, 0.7])
def test_it_holds_the_true_mean_at_its_level(scenes, runs, spread):
    rng = np.random.default_rng(3)
    scale = np.exp(rng.normal(0.0, spread, (20_000, scenes, 1)))  # scenes vary differently
    values = rng.normal(0.0, scale, (20_000, scenes, runs)).reshape(20_000, -1)
    sizes = (runs,) * scenes
    covered = np.abs(mean(values, sizes)) <= half_width(values, sizes)
    assert covered.mean() > 0.943  # three standard deviations of 20,000 tries below 0.95
    assert covered.mean() < 0.99
    drawn = np.random.default_rng(4).integers(0, runs, (300, scenes, runs)) + runs * np.arange(scenes)[:, None]
    resampled = mean(values[:2000, drawn.reshape(300, -1)], sizes)  # what a percentile bootstrap would say
    low, high = np.percentile(resampled, [2.5, 97.5], axis=-1)
    assert ((low <= 0) & (high >= 0)).mean() < 0.92


@pytest.mark.parametrize("statistic", [median, interquartile_mean])
@pytest.mark.parametrize(("scenes", "runs", "apart"), [(1, 6, 0.0), (5, 3, 0.0), (5, 3, 10.0)])
def test_other_statistics_hold_their_value_at_the_level(statistic, scenes, runs, apart):
    # With scenes that are far apart, the runs of the middle one alone decide the median.
    values = np.random.default_rng(5).normal(0.0, 1.0, (1000, scenes * runs))
    values += np.repeat(apart * (np.arange(scenes) - (scenes - 1) / 2), runs)
    sizes = (runs,) * scenes
    covered = np.abs(statistic(values, sizes)) <= half_width(values, sizes, statistic)
    assert 0.93 < covered.mean() <= 1.0


def test_the_distance_of_scenes_has_no_part_in_it():
    rng = np.random.default_rng(3)
    first, second = rng.normal(0.0, 1.0, 5), rng.normal(0.0, 1.0, 7)
    near, far = estimate([first, second]), estimate([first, second + 100.0])
    np.testing.assert_allclose(far.high - far.low, near.high - near.low)


def test_resamples_have_one_run_less_of_every_scene():
    draws = stratified_draws((2, 5, 3))
    assert draws.shape == (1000, 7)
    for columns, runs in ((slice(0, 1), (0, 2)), (slice(1, 5), (2, 7)), (slice(5, 7), (7, 10))):
        assert set(np.unique(draws[:, columns])) == set(range(*runs))
    assert len(np.unique(draws, axis=0)) > 500


def test_equal_runs_have_an_interval_without_width():
    found = estimate([np.full(3, 2.0), np.full(2, 4.0)])
    assert (found.low, found.value, found.high) == (3.0, 3.0, 3.0)


def test_equal_input_gives_equal_intervals():
    strata = [np.arange(7.0), np.arange(5.0)]
    for statistic in (mean, interquartile_mean):
        assert estimate(strata, statistic) == estimate(strata, statistic)
    assert estimate(strata, level=0.5).low > estimate(strata).low


def test_one_run_on_a_scene_gives_no_interval():
    found = estimate([np.array([1.0, 2.0]), np.array([5.0])])
    assert found.value == 3.25 and not found.has_interval and not found.excludes(-100.0)


def test_what_an_interval_excludes():
    found = estimate([np.array([1.0, 2.0, 3.0])])  # [-0.48, 4.48]
    assert found.excludes(-0.5) and not found.excludes(0.0) and found.excludes(4.5)


@pytest.mark.parametrize("strata", [[], [np.zeros(0)], [np.ones(2), np.zeros(0)]])
def test_a_scene_without_runs_is_an_error(strata):
    with pytest.raises(ValueError, match="at least one run"):
        estimate(strata)
