import pytest

from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.report.tables.columns import aspects
from activestructure_gym.evaluation.report.tables.paper import ablation_table, quality_table, time_table
from activestructure_gym.policies.activestructure import LADDER


@pytest.fixture
def results(make_run):
    runs = [
        make_run(
            scene, policy, seed, psnr=20.0 + 2 * (policy == "b") + (scene == "box") + seed, seconds=60.0 + 60 * seed
        )
        for scene in ("room", "box") for policy in ("a", "b") for seed in range(2)
    ]  # fmt: skip
    return Results([*runs, make_run("room", "c", 0)], [])


def cell(table, row, heading):
    column = [h.text for h in table.headings].index(heading)
    return next(cells[column] for cells in table.rows if [c.text for c in cells][: len(row)] == row)


def test_tables_1_and_2_have_a_row_per_method_and_metric_and_an_average(results):
    table = quality_table(results, aspects(results.runs)[0])
    assert [h.text for h in table.headings] == ["Method", "Metric", "room", "box", "Avg."]
    assert cell(table, ["a", "PSNR (dB) ↑"], "room").text == "20.50"
    assert cell(table, ["b", "PSNR (dB) ↑"], "Avg.").text == "23.00"
    assert [cell(table, [p, "PSNR (dB) ↑"], "box").rank for p in "ab"] == [2, 1]
    assert cell(table, ["c", "PSNR (dB) ↑"], "box").text == cell(table, ["c", "PSNR (dB) ↑"], "Avg.").text == "–"
    # Not measured in any run: no row. One block per method.
    assert not any("LPIPS" in row[1].text for row in table.rows)
    assert [table.rows[start][0].text for start in (0, *table.blocks)] == ["a", "b", "c"]


def test_table_3_has_a_row_per_variant_with_intervals(results):
    table = ablation_table(results, aspects(results.runs)[0])
    assert [row[0].text for row in table.rows] == ["a", "b", "c"]
    found = cell(table, ["b"], "PSNR (dB) ↑")
    assert found.text == "23.00 [21.48, 24.52]" and found.rank == 1
    assert cell(table, ["c"], "PSNR (dB) ↑").text == "–"


def test_the_ladder_has_the_papers_names(make_run):
    rungs = ["activestructure-a", "activestructure-b", LADDER[-1]]
    runs = [make_run(policy=policy) for policy in rungs]
    table = ablation_table(Results(runs, []), aspects(runs)[0])
    assert [row[0].text for row in table.rows] == ["(A) Pixel-only", "(B) + PSG gain", "(E) Full model"]


def test_table_4_is_one_row_of_minutes(results):
    table = time_table(results)
    (row,) = table.rows
    assert list(table.groups) == [("", 1), ("room", 3), ("box", 3)]
    assert [c.text for c in row] == ["Time (min)", "1.50", "1.50", "0.17", "1.50", "1.50", "–"]
    assert [c.rank for c in row[1:4]] == [2, 2, 1]


def test_a_further_protocol_and_the_surface_have_tables_of_their_own(make_run):
    notes = {"lpips": "weights not supplied"}
    runs = [make_run(policy=policy, tsdf_accuracy_cm=0.5, lpips=None, notes=notes) for policy in "ab"]
    for run in runs:
        run.protocols["activegamer"] = {"parameters": {"name": "activegamer"}, "metrics": {"psnr": 30.0, "notes": {}}}
        sizes = {"keyframes": 40, "gaussians": 1200}  # of a map that the protocol trains
        run.protocols["offline"] = {"parameters": {"name": "offline"}, "metrics": {"psnr": 31.0, "notes": {}, **sizes}}
    found = aspects(runs)
    assert [(aspect.name, aspect.title) for aspect in found] == [
        ("", "standard"), ("tsdf", "standard, TSDF surface"), ("activegamer", "activegamer"),
        ("offline", "offline"),
    ]  # fmt: skip
    own, surface, other, trained = (ablation_table(Results(runs, []), aspect) for aspect in found)
    assert (surface.name, other.name) == ("variants-tsdf", "variants-activegamer")
    assert [cell.text for cell in surface.rows[0]] == ["a", "0.50"]
    assert [cell.text for cell in other.rows[0]] == ["a", "30.00"]
    assert [heading.text for heading in trained.headings] == ["Policy", "PSNR (dB) ↑", "keyframes", "Gaussians"]
    assert [cell.text for cell in trained.rows[0]] == ["a", "31.00", "40", "1200"]
    assert not any(heading.text.startswith("LPIPS") for heading in own.headings)  # no run has it


def test_a_number_that_some_runs_lack_says_why(make_run):
    notes = {"lpips": "weights not supplied"}
    runs = [make_run(policy="a", lpips=None, notes=notes), make_run(policy="b", lpips=0.25)]
    found = cell(ablation_table(Results(runs, []), aspects(runs)[0]), ["a"], "LPIPS ↓")
    assert (found.text, found.note, found.rank) == ("n/a", "weights not supplied", 0)
