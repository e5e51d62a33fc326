"""A sweep in the report: rows, lines, table and charts, from runs with numbers chosen by hand."""

import re
from dataclasses import replace

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.protocols.metrics.without_truth import WITHOUT_TRUTH
from activestructure_gym.evaluation.report.charts.sweep import sweep_charts
from activestructure_gym.evaluation.report.page.table_sections import sweep_section
from activestructure_gym.evaluation.report.results import Results, labelled
from activestructure_gym.evaluation.report.tables.columns import MAIN
from activestructure_gym.evaluation.report.tables.formats import latex, to_csv
from activestructure_gym.evaluation.report.tables.sweep import sweep_lines, sweep_table
from activestructure_gym.evaluation.report.tables.verdicts import differences

# PSNR by policy and value: seed 0; seed 1 has 1 dB more.
PSNR = {("a", 4): 20.0, ("a", 1): 22.0, ("a", 2): 24.0, ("random", 4): 10.0, ("random", 1): 10.0, ("random", 2): 9.0}


@pytest.fixture
def runs(make_run):
    return [
        make_run("room", policy, seed, swept={"x.y": value}, psnr=psnr + seed)
        for seed in (0, 1) for (policy, value), psnr in PSNR.items()
    ]  # fmt: skip


def test_a_row_is_a_policy_with_its_values_and_pairs_share_scene_and_seed(runs):
    results = Results(runs, [])
    assert results.sweep == {"x.y": [1, 2, 4]}
    assert results.policies[:2] == ["a [x.y=4]", "a [x.y=1]"] and len(results.policies) == 6
    # The default baseline is the usual one, with the first of its values; a policy's name alone means the same.
    assert results.baseline == Results(runs, [], "random").baseline == "random [x.y=4]"
    assert Results(runs, [], "a [x.y=2]").baseline == "a [x.y=2]"
    (psnr,) = [column for column in MAIN if column.key == "psnr"]
    found = differences(results, psnr)
    assert found["a [x.y=2]"].difference.value == 14.0 and found["a [x.y=2]"].pairs == 2
    with pytest.raises(InputError, match=re.escape("different conditions (sweep: x.y, none)")):
        job = replace(runs[0].job, swept=(), conditions=runs[0].job.shared_conditions)
        Results([*runs, replace(runs[0], job=job)], [])


def test_the_table_has_the_field_as_x(runs):
    table = sweep_table(Results(runs, []))
    assert [heading.text for heading in table.headings] == ["Metric", "x.y", "a", "random"]
    # Two runs, 1 dB apart: 12.7 standard errors of 0.5 dB on each side.
    rows = {row[1].text: row[2:] for row in table.rows if row[0].text == "PSNR (dB) ↑"}
    assert [cell.text for cell in rows["1"]] == ["22.50 [16.15, 28.85]", "10.50 [4.15, 16.85]"]
    assert {x: (a.value, b.value) for x, (a, b) in rows.items()} == {
        "1": (22.5, 10.5),
        "2": (24.5, 9.5),
        "4": (20.5, 10.5),
    }
    # Ranks are within a column, and equal numbers share one.
    assert {x: (a.rank, b.rank) for x, (a, b) in rows.items()} == {"1": (2, 1), "2": (1, 3), "4": (3, 1)}
    assert 'PSNR (dB) ↑,1,"22.50 [16.15, 28.85]","10.50 [4.15, 16.85]"' in to_csv(table)
    assert r"\label{tab:sweep}" in latex(table)
    assert table.name == "sweep" and sweep_table(Results([runs[0]], [])).rows[0][2].text != ""


def test_runs_without_ground_truth_have_each_metric_once(make_run):
    runs = [make_run(swept={"n": n}, known_m3=9.0, keyframe_psnr=30.0) for n in (1, 2)]
    for run in runs:
        run.metrics["own_metrics"] = [metric.as_dict() for metric in WITHOUT_TRUTH]
    names = [row[0].text for row in sweep_table(Results(runs, [])).rows]
    assert names.count("known (m³) ↑") == names.count("keyframe PSNR (dB) ↑") == 2


def test_no_sweep_no_table(make_run):
    results = Results([make_run()], [])
    assert (results.sweep, sweep_lines(results), sweep_charts(results)) == ({}, {}, [])
    assert sweep_table(results) is None and sweep_section(results) is None


def test_the_other_fields_distinguish_lines_and_a_missing_run_is_a_gap(make_run):
    runs = [
        make_run("room", "a", 0, swept={"n": n, "noise": noise}, psnr=10.0 * n + (noise == "kinect"))
        for n in (1, 2) for noise in ("none", "kinect")
    ][:3]  # fmt: skip
    results = Results(runs, [])
    assert sweep_lines(results) == {
        "a [noise=none]": {0: "a [n=1, noise=none]", 1: "a [n=2, noise=none]"},
        "a [noise=kinect]": {0: "a [n=1, noise=kinect]"},
    }
    # Two runs, 1 dB apart: 12.7 standard errors of 0.5 dB on each side.
    rows = {row[1].text: [cell.text for cell in row[2:]] for row in sweep_table(results).rows if "PSNR" in row[0].text}
    assert rows == {"1": ["10.00", "11.00"], "2": ["20.00", "–"]}
    page = sweep_section(results)
    assert "Each line has one value of noise." in page and page.count("<svg") >= 2


def test_labels_of_policies_keep_the_values(runs):
    named = Results(labelled(runs, {"a": "Ours", "random [x.y=1]": "Chance"}), [])
    assert {"Ours [x.y=1]", "Chance", "random [x.y=2]"} < set(named.policies)
    assert list(sweep_lines(named)) == ["Ours", "random"] and sweep_lines(named)["random"][0] == "Chance"
    with pytest.raises(InputError, match="two names would have the label 'random'"):
        labelled(runs, {"a": "random"})


@pytest.mark.parametrize(
    "values, places",
    [
        ((1, 2, 4), [1, 2, 4]),
        ((0.06, 0.12, 0.24), [0.06, 0.12, 0.24]),
        ((1, 2, 1000), [0, 1, 2]),  # 1 and 2 would overlap
        (("none", "kinect"), [0, 1]),
        ((False, True), [0, 1]),
        ((3,), [0]),
    ],
)
def test_numbers_are_to_scale_unless_they_are_too_close(values, places, make_run):
    runs = [make_run("room", "a", seed, swept={"f": value}, psnr=20.0) for value in values for seed in (0, 1)]
    (_, chart) = sweep_charts(Results(runs, []))[-1]
    found = re.findall(r'<text x="([\d.]+)" y="273.0" text-anchor="middle">([^<]+)</text>', chart)
    assert [text for _, text in found] == [
        str(value).lower() if isinstance(value, bool) else str(value) for value in values
    ]
    if len(values) > 2:
        left, middle, right = (float(x) for x, _ in found)
        share = (places[1] - places[0]) / (places[2] - places[0])
        assert (middle - left) / (right - left) == pytest.approx(share, abs=1e-3)
    # A marker and an interval at every value, and no readout between them.
    assert chart.count('class="mark"') == chart.count('class="interval"') == len(values)
    assert "data-frame" not in chart
