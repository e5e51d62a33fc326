import numpy as np
import pytest

from activestructure_gym.evaluation.report.charts.convergence import MEASURES
from activestructure_gym.evaluation.report.charts.plots import Line
from activestructure_gym.evaluation.report.page.convergence_section import reading

RATIO = MEASURES[0]  # % with one digit


def line(name, *heights):
    return Line(name, 0, np.array([0.0, 50.0, 100.0]), np.array(heights))


@pytest.mark.parametrize(
    "lines, says",
    [
        ([line("a", 0, 40, 80.04)], "C.R.: 40.0 % at frame 50, 80.0 % at the end."),
        ([line("a", 0, 40, 80), line("b", 0, 50, 70)],
         "C.R., highest at the end: a (80.0 %), at frame 50: b (50.0 %)."),
        ([line("a", 0, 50, 80), line("b", 0, 40, 79.9)],
         "C.R., highest at the end: a (80.0 %), at frame 50: a (50.0 %)."),
        ([line("a", 0, 50, 80.01), line("b", 0, 40, 79.99)],  # equal as printed
         "C.R., highest at the end: a and b (80.0 %), at frame 50: a (50.0 %)."),
        ([line(name, 0, 50, 80) for name in "abcde"],
         "C.R., highest at the end: a, b, c and 2 more (80.0 %), at frame 50: a, b, c and 2 more (50.0 %)."),
        ([], ""),
    ],
)  # fmt: skip
def test_what_there_is_to_see_is_said_as_it_is_printed(lines, says):
    assert reading(lines, RATIO) == says
