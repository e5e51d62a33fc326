import math

import pytest

from activestructure_gym.evaluation.report.tables.columns import Column
from activestructure_gym.evaluation.report.tables.layout import Cell, Heading, Table, decimal, ranked, with_interval
from activestructure_gym.evaluation.statistics import Estimate

HIGHER, LOWER = Column("k", "K", "%", 1, "highest"), Column("k", "K", "cm", 1, "lowest")
DECIBELS = Column("k", "K", "dB", 2, "highest")


def test_the_first_three_are_marked_and_equal_as_printed_is_equal():
    cells = [Cell("", value) for value in (90.04, 80.0, 90.01, 70.0, 60.0)]
    assert [cell.rank for cell in ranked(cells, HIGHER)] == [1, 3, 1, 0, 0]
    assert [cell.rank for cell in ranked(cells, LOWER)] == [0, 3, 0, 2, 1]


def test_nobody_is_first_alone_or_where_nothing_is_better():
    assert [cell.rank for cell in ranked([Cell("", 1.0), Cell("n/a")], HIGHER)] == [0, 0]
    cost = Column("k", "K", "s", 1)
    assert [cell.rank for cell in ranked([Cell("", 1.0), Cell("", 2.0)], cost)] == [0, 0]


@pytest.mark.parametrize(
    "value, signed, text", [(-0.04, True, "0.0"), (-0.06, True, "−0.1"), (0.06, True, "+0.1"), (3.0, False, "3.0")]
)
def test_numbers_as_printed(value, signed, text):
    assert decimal(value, 1, signed=signed) == text


def test_intervals_as_printed():
    assert with_interval(Estimate(1.0, 0.5, 1.25, 4), DECIBELS).text == "1.00 [0.50, 1.25]"
    assert with_interval(Estimate(1.0, None, None, 4), DECIBELS).text == "1.00"
    assert with_interval(None, DECIBELS).text == "–" and with_interval(None, DECIBELS).value is None
    assert math.isclose(with_interval(Estimate(1.006, None, None, 1), DECIBELS).value, 1.006)
    wide = Estimate(97.0, -4.0, 103.0, 2)  # no share of the surface is above 100 %
    assert with_interval(wide, HIGHER).text == "97.0 [0.0, 100.0]"
    below = Estimate(-4.0, -5.0, -3.0, 4)  # a metric of one's own, which is no share
    assert with_interval(below, HIGHER).text == "−4.0 [−5.0, −3.0]"
    assert with_interval(wide, HIGHER, signed=True).text == "+97.0 [−4.0, +103.0]"


def test_a_block_says_its_name_once():
    rows = [[Cell("a"), Cell("1")], [Cell("a"), Cell("2")], [Cell("a"), Cell("3")]]
    table = Table("t", "T", [Heading("x"), Heading("y")], rows, blocks=[2])
    assert [table.shown(i, 0) for i in range(3)] == ["a", "", "a"]
    assert table.sortable and not Table("t", "T", [], rows, groups=[("g", 2)]).sortable
