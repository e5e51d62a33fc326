import io

import pytest
from rich.console import Console

from activestructure_gym.evaluation.cli.output import print_whole
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.report.tables.columns import PROGRESS, value_of
from activestructure_gym.evaluation.report.tables.formats import documents
from activestructure_gym.evaluation.report.tables.planning import planning_table, rich_planning_table
from activestructure_gym.evaluation.report.tables.verdicts import difference_table


def measured(make_run, policy, seed, frames_to_90, area=60.0):
    numbers = {"frames_to_80": 40.0 + seed, "frames_to_85": 50.0, "frames_to_90": frames_to_90, "frames_to_95": None}
    return make_run(
        policy=policy, seed=seed, **numbers, observed_area=area, late_psnr_rate=1.0 + seed, late_depth_rate=-2.0
    )


@pytest.fixture
def results(make_run):
    """Policy a reaches 90 % in 60 and 70 frames, b in 80 and not at all, nobody reaches 95 %; the budget is 100."""
    runs = [measured(make_run, "a", 0, 60.0, 65.0), measured(make_run, "a", 1, 70.0, 67.0)]
    return Results([*runs, measured(make_run, "b", 0, 80.0), measured(make_run, "b", 1, None)], [], "b")


def test_who_did_not_reach_it_counts_with_the_budget_and_the_table_says_so(results):
    table = planning_table(results)
    columns = {heading.text: k for k, heading in enumerate(table.headings)}
    a, b = table.rows
    at_90 = columns["frames to 90 % ↓"]
    assert a[at_90].value == 65.0 and a[at_90].rank == 1 and a[at_90].text.startswith("65 [")
    assert b[at_90].value == 90.0 and b[at_90].rank == 2 and b[at_90].text == "> 90"  # without an interval
    assert b[at_90].note == "not reached in 1 of 2 runs"
    assert "frames to 95 % ↓" not in columns and "No run observed 95 % of the surface" in table.caption
    assert "95 % intervals" in table.caption
    assert a[columns["exploration (%) ↑"]].value == 66.0
    assert {name.partition(".")[0] for name in documents([table])} == {"planning"}


def test_differences_to_the_baseline_hold_them_too(results):
    rows = {row[1].text: row for row in difference_table(results).rows}
    # 60 - 80 and 70 - 100.
    assert rows["frames to 90 % ↓"][2].value == -25.0
    assert rows["exploration (%) ↑"][2].value == 6.0
    assert "frames to 95 % ↓" not in rows and "No run observed 95 % of the surface" in difference_table(results).caption


def test_a_row_of_a_pair_that_never_reached_a_level_is_left_out(make_run):
    runs = [measured(make_run, policy, 0, frames) for policy, frames in (("a", None), ("b", None), ("c", 90.0))]
    table = difference_table(Results(runs, [], "a"))
    assert [row[0].text for row in table.rows if row[1].text == "frames to 90 % ↓"] == ["c"]
    assert "intervals" not in planning_table(Results(runs, [], "a")).caption  # a run each has no interval


def printed(results):
    out = io.StringIO()
    print_whole(Console(file=out, width=120), rich_planning_table(results))
    return out.getvalue()


def test_a_terminal_has_the_number_that_there_is_and_how_many_runs_reached_it(results):
    lines = [line for line in printed(results).splitlines() if line.strip()]
    headings, a, b = " ".join(lines[1:3]), lines[-2], lines[-1]
    assert "policy" in headings and "85 %" in headings and "95 %" not in headings
    assert a.split() == ["a", "50", "65", "66.0"]
    assert b.split() == ["b", "50", *"> 90 (1 of 2 runs)".split(), "60.0"]


def test_a_terminal_has_no_column_for_what_no_run_reached(make_run):
    none = {f"frames_to_{level}": None for level in (80, 85, 90, 95)}
    runs = [make_run(policy=name, **none, observed_area=50.0) for name in "ab"]
    said = printed(Results(runs, []))
    assert "no run observed 80 %" in said and "frames to" not in said and "50.0" in said
    runs[0].metrics["metrics"]["frames_to_80"] = 40.0
    said = printed(Results(runs, []))
    assert "not reached" in said and "40" in said and "85 %" not in said


def test_where_half_of_the_runs_reach_no_level_a_terminal_shows_the_lowest(make_run):
    late = {"frames_to_80": None, "frames_to_85": None, "frames_to_90": None, "frames_to_95": None}
    runs = [make_run(policy=policy, **late, observed_area=50.0) for policy in "ab"]
    runs.append(measured(make_run, "c", 0, 60.0))
    assert "80 %" in (text := printed(Results(runs, [], None))) and "85 %" in text and "90 %" not in text


def test_a_reference_has_no_rank_and_takes_none(make_run):
    runs = [measured(make_run, policy, 0, frames) for policy, frames in (("a", 70.0), ("b", 60.0))]
    best = measured(make_run, "reference:oracle", 0, 40.0, 99.0)
    results = Results([best, *runs], [], "a")
    table = planning_table(results)
    at_90 = [heading.text for heading in table.headings].index("frames to 90 % ↓")
    assert [row[at_90].value for row in table.rows] == [40.0, 70.0, 60.0]
    assert [row[at_90].rank for row in table.rows] == [0, 2, 1]
    assert not any(cell.rank for cell in table.rows[0])


def test_runs_that_were_not_measured_so_have_no_table(make_run):
    run = make_run()
    assert all(value_of(run, column.key) is None for column in PROGRESS)
    assert planning_table(Results([run], [], None)) is None
    assert rich_planning_table(Results([run], [], None)) is None
