import numpy as np
import pytest

from activestructure_gym.evaluation.statistics import area_under, curve_band, estimate, interquartile_mean, on_axis


def test_a_run_that_has_ended_keeps_its_map():
    x, y = np.array([1.0, 3.0]), np.array([10.0, 30.0])
    np.testing.assert_allclose(on_axis(x, y, np.array([0.0, 2.0, 3.0, 9.0])), [10.0, 20.0, 30.0, 30.0])


@pytest.mark.parametrize("x", [[], [1.0, 1.0], [2.0, 1.0]])
def test_costs_must_rise(x):
    with pytest.raises(ValueError, match="rise strictly"):
        on_axis(np.array(x), np.zeros(len(x)), np.zeros(1))


def test_the_area_is_the_mean_height_up_to_the_budget():
    x, y = np.array([0.0, 10.0]), np.array([0.0, 10.0])
    assert area_under(x, y, 10.0) == 5.0
    assert area_under(x, y, 4.0) == 2.0  # the budget lies between two points
    assert area_under(x, y, 20.0) == (50.0 + 100.0) / 20.0  # then 10 for ten more
    assert area_under(np.array([5.0]), np.array([7.0]), 3.0) == 7.0
    with pytest.raises(ValueError, match="above 0"):
        area_under(x, y, 0.0)


def test_the_area_equals_a_fine_sum():
    rng = np.random.default_rng(0)
    x, y = np.cumsum(rng.uniform(0.1, 2.0, 12)), rng.normal(size=12)
    places = np.linspace(0.0, 9.0, 200_001)
    assert np.isclose(area_under(x, y, 9.0), on_axis(x, y, places).mean(), atol=1e-4)


def test_a_band_is_the_standard_error_at_every_place():
    rng = np.random.default_rng(2)
    strata = [rng.normal(size=(4, 3)), rng.normal(size=(6, 3))]
    line, low, high = curve_band(strata)
    for place in range(3):
        one = estimate([curves[:, place] for curves in strata])
        np.testing.assert_allclose([line[place], low[place], high[place]], one.value + one.error * np.array([0, -1, 1]))


def test_a_band_of_another_statistic_and_none_of_a_single_run():
    curves = np.array([[1.0], [2.0], [3.0], [100.0]])
    line, low, high = curve_band([curves], interquartile_mean)
    assert line[0] == 2.5 and low[0] <= 2.5 <= high[0]
    assert curve_band([curves[:1]])[1:] == curve_band([curves], banded=False)[1:] == (None, None)
