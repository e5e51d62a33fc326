import numpy as np
from scipy.stats import trim_mean

from activestructure_gym.evaluation.statistics import interquartile_mean, mean, median

VALUES = np.array([1.0, 2.0, 30.0, 7.0, 9.0])
SIZES = (2, 3)  # scene 1: 1, 2; scene 2: 30, 7, 9


def test_the_mean_counts_every_scene_the_same():
    # (1.5 + 46 / 3) / 2, not the mean of all five.
    assert mean(VALUES, SIZES) == (1.5 + 46 / 3) / 2


def test_the_median_is_over_the_scenes_means_and_with_one_scene_over_its_runs():
    three = np.array([1.0, 3.0, 10.0, 20.0, 5.0, 5.0])
    assert median(three, (2, 2, 2)) == 5.0  # of 2, 15 and 5
    assert median(VALUES, (5,)) == 7.0


def test_the_interquartile_mean_is_the_trimmed_mean_of_all_runs():
    rng = np.random.default_rng(0)
    for count in (1, 3, 4, 5, 8, 11):
        values = rng.normal(size=count)
        assert np.isclose(interquartile_mean(values, (count,)), trim_mean(values, 0.25))
    assert interquartile_mean(VALUES, SIZES) == (2 + 7 + 9) / 3  # without 1 and 30


def test_rows_are_resamples():
    rows = np.stack([VALUES, VALUES + 1])
    for statistic in (mean, median, interquartile_mean):
        both = statistic(rows, SIZES)
        np.testing.assert_allclose(both, [statistic(VALUES, SIZES), statistic(VALUES, SIZES) + 1])
