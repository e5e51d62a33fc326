import pytest

from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.report.summary import all_tables
from activestructure_gym.evaluation.report.tables.columns import QUALITY
from activestructure_gym.evaluation.report.tables.verdicts import (
    aggregate_table,
    area_table,
    cost_table,
    difference_table,
    differences,
    has_intervals,
    improvement_table,
    leads,
    verdict,
)
from activestructure_gym.evaluation.statistics import Estimate, PairedDifference

COLUMNS = {column.key: column for column in QUALITY}


@pytest.fixture
def grid(make_run):
    """Policy b is better than a by 2 to 5 in PSNR and worse in accuracy, on 2 scenes x 4 seeds."""

    def make(**numbers):
        return Results(
            [
                make_run(
                    scene, policy, seed, psnr=20.0 + 3 * seed + (2 + seed if policy == "b" else 0),
                    accuracy_cm=1.0 + 0.1 * seed + (0.5 if policy == "b" else 0.0), **numbers,
                )
                for scene in ("room", "box") for policy in ("a", "b") for seed in range(4)
            ],
            [],
            "a",
        )  # fmt: skip

    return make


def test_a_difference_says_whether_zero_is_excluded_and_which_way_is_better(grid):
    results = grid()
    psnr = differences(results, COLUMNS["psnr"])["b"]
    assert psnr.difference.value == 3.5 and psnr.difference.low > 2.0
    assert verdict(psnr, COLUMNS["psnr"]) == ("better (95 %)", "good")
    accuracy = differences(results, COLUMNS["accuracy_cm"])["b"]
    assert verdict(accuracy, COLUMNS["accuracy_cm"]) == ("worse (95 %)", "bad")
    ssim = differences(results, COLUMNS["ssim"])["b"]
    assert verdict(ssim, COLUMNS["ssim"]) == ("equal as printed", "")


@pytest.mark.parametrize(
    ("difference", "words"),
    [
        ((-0.003, -0.006, 0.0), "no significant difference"),  # printed: 0.00 [-0.01, 0.00]
        ((-0.003, -0.004, -0.001), "equal as printed"),  # printed: 0.00 [0.00, 0.00]
        ((-0.012, -0.02, -0.004), "no significant difference"),  # printed: -0.01 [-0.02, 0.00]
        ((-0.012, -0.02, -0.006), "better (95 %)"),  # printed: -0.01 [-0.02, -0.01]
        ((0.012, 0.006, 0.02), "worse (95 %)"),
        ((-0.003, None, None), ""),
    ],
)
def test_a_verdict_is_about_the_numbers_as_they_are_printed(difference, words):
    pair = PairedDifference(Estimate(*difference, 16), 0, 0, 8)
    assert verdict(pair, COLUMNS["accuracy_cm"])[0] == words


def test_what_is_smaller_than_the_last_digit_is_neither_better_nor_worse_anywhere(make_run):
    runs = [make_run(policy=p, seed=s, depth_l1_cm=1.0 - 0.003 * (p == "b")) for p in "ab" for s in range(8)]
    results = Results(runs, [], "a")
    row = next(row for row in difference_table(results).rows if row[1].text.startswith("Depth"))
    assert [cell.text for cell in row[2:5]] == ["0.00 [0.00, 0.00]", "equal as printed", "0 / 8 / 0"]
    assert row[3].tone == "" and row[5].text == "0.50"
    lead = next(lead for lead in leads(results) if lead.column.key == "depth_l1_cm")
    assert {lead.policy, *lead.tied} == {"a", "b"} and lead.margin is None


def test_few_pairs_are_said(grid):
    results = grid()
    few = Results([run for run in results.runs if run.job.seed < 2], [], "a")
    words, tone = verdict(differences(few, COLUMNS["psnr"])["b"], COLUMNS["psnr"])
    assert words == "better (95 %), 4 pairs only" and not tone
    one = Results([run for run in results.runs if run.job.seed < 1], [], "a")
    assert verdict(differences(one, COLUMNS["psnr"])["b"], COLUMNS["psnr"]) == ("", "")
    assert [heading.text for heading in difference_table(one).headings][2:] == ["Difference", "better / equal / worse"]


@pytest.mark.parametrize(("seeds", "told"), [((1, 1), False), ((2, 1), False), ((2, 2), True)])
def test_chance_can_be_told_from_two_pairs_on_every_scene(make_run, seeds, told):
    counts = dict(zip(("room", "box"), seeds))
    runs = [make_run(scene, policy, seed) for scene, n in counts.items() for policy in "ab" for seed in range(n)]
    assert has_intervals(Results(runs, [], "a")) is told
    assert has_intervals(Results([run for run in runs if run.policy == "a"], [])) is False


def test_the_table_of_differences(grid, make_run):
    table = difference_table(grid())
    row = next(row for row in table.rows if row[1].text.startswith("PSNR"))
    assert [cell.text for cell in row][:2] == ["b", "PSNR (dB) ↑"]
    assert row[2].text.startswith("+3.50 [+") and row[3].tone == "good" and row[4].text == "8 / 0 / 0"
    # Of a 20, 23, 26, 29, of b 22, 26, 30, 34: b wins 1 + 2.5 + 4 + 4 of 16.
    assert row[5].value == 11.5 / 16
    accuracy = next(row for row in table.rows if row[1].text.startswith("Acc"))
    assert accuracy[4].text == "0 / 0 / 8"
    assert difference_table(Results([make_run()], [])) is None


def test_improvement_adds_up_to_one_and_is_coloured_where_it_is_sure(grid):
    table = improvement_table(grid(), COLUMNS["accuracy_cm"])
    (_, nothing, a_over_b), (_, b_over_a, _) = table.rows
    assert nothing.text == "–" and a_over_b.value + b_over_a.value == 1.0
    assert (a_over_b.tone, b_over_a.tone) == ("good", "bad")


def test_who_leads_and_by_how_much(grid):
    found = {lead.column.key: lead for lead in leads(grid())}
    assert found["psnr"].policy == "b" and found["psnr"].runner_up == "a"
    assert found["psnr"].margin.difference.value == 3.5
    assert list(found) == ["completion_ratio", "psnr"]  # in the order of the cards; Acc has none


def test_the_first_card_is_what_was_observed(make_run):
    numbers = {"observed": 60.0, "observed_area": 40.0, "depth_l1_cm": 2.0}
    results = Results([make_run(policy=policy, **numbers) for policy in "ab"], [], "a")
    order = [lead.column.header for lead in leads(results)]
    assert order == ["observed", "exploration", "C.R.", "PSNR", "Depth"]


def test_collisions_are_an_alarm(grid):
    table = cost_table(grid(collisions=1))
    column = [heading.text for heading in table.headings].index("collisions")
    assert [(row[column].text, row[column].tone) for row in table.rows] == [("8", "alarm")] * 2
    assert cost_table(grid()).rows[0][column].tone == "good"


def test_collisions_that_were_not_measured_are_missing_and_not_zero(make_run):
    runs = [make_run(policy="p", collisions=None), make_run(policy="q")]
    table = cost_table(Results(runs, []))
    column = [heading.text for heading in table.headings].index("collisions")
    assert [(row[column].text, row[column].tone) for row in table.rows] == [("–", ""), ("0", "good")]
    headings = [heading.text for heading in table.headings]
    assert table.rows[0][headings.index("planning (s)")].text == "3.5"
    assert table.rows[0][headings.index("mapping (s)")].text == "4.0"


def test_aggregates_and_areas_name_every_statistic_and_axis(grid):
    table = aggregate_table(grid())
    psnr = [row for row in table.rows if row[0].text.startswith("PSNR")]
    assert [row[1].text for row in psnr] == ["mean", "median", "IQM"]
    assert psnr[0][2].text.startswith("24.50 [") and [cell.rank for cell in psnr[0][2:]] == [2, 1]
    areas = area_table(grid())
    axes = [heading.text.split(", ")[1] for heading in areas.headings[1:]]
    assert axes == ["frames", "metres", "seconds"] * 2 and areas.headings[4].text.startswith("PSNR (dB)")
    assert [row[0].text for row in areas.rows] == ["a", "b"] and len(areas.headings) == 7
    assert all(cell.value is not None for row in areas.rows for cell in row[1:])
    assert [cell.rank for cell in areas.rows[0][1:]] == [1] * 6  # both have the same curves


def test_a_reference_leads_nobody(make_run):
    seen = make_run(policy="reference:oracle", psnr=30.0)
    results = Results([make_run(policy="a", psnr=20.0), seen], [], "a")
    assert {lead.policy for lead in leads(results)} == {"a"}
    assert results.policies == ["a", "oracle (reference, sees the ground truth)"]


def test_no_table_ranks_a_reference(make_run):
    psnr = {"reference:oracle": 30.0, "a": 20.0, "b": 21.0}
    results = Results([make_run(policy=policy, psnr=value, seconds=value) for policy, value in psnr.items()], [], "a")
    name = results.policies[0]
    for table in all_tables(results):
        headings = [heading.text for heading in table.headings]
        for row in table.rows:
            if row[0].text == name or row[0].note == name:
                assert not any(cell.rank for cell in row), table.name
            for heading, cell in zip(headings, row):
                assert heading != name or not cell.rank, table.name
    ranks = [[cell.rank for cell in row[2:]] for row in aggregate_table(results).rows if row[0].text == "PSNR (dB) ↑"]
    assert ranks == [[0, 2, 1]] * 3
