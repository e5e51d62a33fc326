"""The sentence on a choice, and the table of the chosen view and the runner-up."""

from __future__ import annotations

import pytest

from activestructure_gym.evaluation.archive.decisions import Row
from activestructure_gym.evaluation.replay.reasons import combined, compared, reason


def row(number: int, score: float | None, terms: dict[str, float] | None = None, **features: float) -> Row:
    return Row(number, score, {"path_length": 1.25, "frames": 7.0}, features, terms or {})


def scored(number: int, **terms: float) -> Row:
    named = {name.replace("times_", "× "): value for name, value in terms.items()}
    return row(number, combined(named), named)


def test_the_term_without_whose_lead_the_choice_would_change_decided() -> None:
    """Not the term with the largest ratio: `planes` is ten times the runner-up's, and too small to matter."""
    rows = [scored(5, area=0.8, planes=0.01, times_travel=0.5), scored(8, area=0.6, planes=0.001, times_travel=0.6)]
    assert reason("mine", rows) == "Chosen for its area of 0.8; the runner-up has 0.6."
    rows = [scored(8, area=0.6, times_travel=0.6), scored(5, area=0.8, times_travel=0.4)]
    assert reason("mine", rows) == "Chosen for its lower travel cost, a factor of 0.6; the runner-up has 0.4."


def test_no_term_decides_if_the_choice_stays_without_each() -> None:
    rows = [scored(5, area=0.8, planes=0.4, times_travel=1.0), scored(8, area=0.6, planes=0.3, times_travel=1.0)]
    assert reason("mine", rows) == (
        "Chosen for the best score, 1.2; the runner-up has 0.9. It leads most by its area of 0.8 against 0.6."
    )


def test_terms_that_do_not_make_up_the_score_decide_nothing() -> None:
    rows = [row(5, 0.9, {"area": 0.8}), row(8, 0.7, {"area": 0.6})]
    assert reason("mine", rows) == "Chosen for the best score, 0.9; the runner-up has 0.7."


def test_scores_without_terms_equal_scores_and_no_scores() -> None:
    assert reason("mine", [row(5, -0.0), row(8, -0.7)]) == "Chosen for the best score, 0; the runner-up has −0.7."
    assert reason("mine", [row(5, 0.9), row(8, -0.7)]) == "Chosen for the best score, 0.9; the runner-up has −0.7."
    assert reason("mine", [row(5, 0.9), row(8, 0.9)]).startswith("Two views have the best score, 0.9.")
    assert reason("mine", [row(5, 0.9)]) == "mine compared this view with no other."
    nothing = Row(5, None, {"path_length": 0.0, "frames": 0.0}, {}, {})
    assert reason("mine", [nothing]) == "mine chose row 5, which holds no candidate: the camera did not move."
    assert reason("random", [row(5, None)]) == "random chose this view without comparing scores."


def test_the_table_has_terms_or_some_features() -> None:
    terms = {"nothing": 0.0, "times_one": 1.0}
    table = compared([scored(5, area=0.8, times_travel=0.5, **terms), scored(8, area=0.6, times_travel=0.6, **terms)])
    assert table == [
        ["score", "0.4", "0.36"], ["area", "0.8", "0.6"], ["× travel", "0.5", "0.6"],
        ["path", "1.25 m", "1.25 m"], ["frames", "7", "7"],
    ]  # fmt: skip
    assert [line[0] for line in compared([row(5, None, area=1.0)])] == ["area", "path", "frames"]
    many = {f"look_{n}": float(n) for n in range(30)}
    pair = [row(5, 1.0, **many), row(8, 0.5, **many | {"look_29": 0.0})]
    assert [line[0] for line in compared(pair)][1:-2] == ["look_29"]


@pytest.mark.parametrize(("terms", "score"), [({"× travel": 0.5}, 0.5), ({"a": 2.0, "b": 1.0, "× c": 0.5}, 1.5)])
def test_a_score_is_the_sum_times_the_factors(terms: dict[str, float], score: float) -> None:
    assert combined(terms) == score
