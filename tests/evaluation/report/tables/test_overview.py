import csv
import io

import numpy as np
import pytest
from rich.console import Console

from activestructure_gym.evaluation.archive.store import read_run, write_evaluation
from activestructure_gym.evaluation.cli.output import print_whole
from activestructure_gym.evaluation.report.tables.columns import COLUMNS, chosen_columns
from activestructure_gym.evaluation.report.tables.formats import markdown
from activestructure_gym.evaluation.report.tables.overview import AVERAGE, overview, rich_table, runs_csv, table_rows
from tests.evaluation.written_runs import write_run


def test_mean_and_sample_deviation_over_the_seeds(make_run):
    (row,) = table_rows([make_run(seed=0, psnr=20.0), make_run(seed=1, psnr=22.0), make_run(seed=2, psnr=27.0)])
    # Mean 23; deviations -3, -1, 4: sqrt((9 + 1 + 16) / 2) = 3.61.
    assert row.cells["psnr"].text(2) == "23.00 ± 3.61"
    assert row.runs == 3
    (alone,) = table_rows([make_run(psnr=20.0)])
    assert alone.cells["psnr"].text(2) == "20.00"


def test_the_best_of_a_scene_is_marked_and_a_cost_has_none(make_run):
    rows = table_rows(
        [
            make_run(policy="a", accuracy_cm=1.0, completion_ratio=80.0, frames=90, ssim=0.70004),
            make_run(policy="b", accuracy_cm=2.0, completion_ratio=85.0, frames=100, ssim=0.70001),
        ]
    )
    best = {(row.policy, key) for row in rows for key, cell in row.cells.items() if cell.best}
    # SSIM is equal as printed, so both are best; frames, metres and seconds are costs.
    assert best & {("a", "accuracy_cm"), ("b", "accuracy_cm")} == {("a", "accuracy_cm")}
    assert best & {("a", "completion_ratio"), ("b", "completion_ratio")} == {("b", "completion_ratio")}
    assert {("a", "ssim"), ("b", "ssim")} <= best
    assert not {key for _, key in best} & {"frames", "metres", "seconds"}


def test_one_policy_alone_is_not_best(make_run):
    (row,) = table_rows([make_run()])
    assert not any(cell.best for cell in row.cells.values())


def test_a_reference_is_never_best_and_marks_nobody_who_is_alone_beside_it(make_run):
    seen = make_run(policy="reference:oracle", psnr=30.0)
    rows = table_rows([seen, make_run(policy="a", psnr=20.0), make_run(policy="b", psnr=21.0)])
    assert [row.cells["psnr"].best for row in rows] == [False, False, True]
    assert not any(cell.best for cell in rows[0].cells.values())
    table = overview(rows, COLUMNS)
    psnr = [heading.text for heading in table.headings].index("PSNR (dB) ↑")
    assert [row[psnr].rank for row in table.rows] == [0, 2, 1]
    alone = table_rows([seen, make_run(policy="a", psnr=20.0)])
    assert not any(cell.best for row in alone for cell in row.cells.values())
    two = [make_run(scene, policy) for scene in ("room", "box") for policy in ("reference:oracle", "a", "b")]
    average = [row for row in table_rows(two) if row.scene == AVERAGE]
    assert [row.planner for row in average] == [False, True, True]


def test_the_average_counts_every_scene_the_same(make_run):
    runs = [
        make_run("room", "a", 0, psnr=10.0),
        make_run("room", "a", 1, psnr=20.0),
        make_run("box", "a", 0, psnr=30.0),
        make_run("room", "b", 0, psnr=10.0),
    ]
    rows = table_rows(runs)
    average = [row for row in rows if row.scene == AVERAGE]
    # (mean(10, 20) + 30) / 2; policy b was not run on both scenes and has no average.
    assert [(row.policy, row.cells["psnr"].mean) for row in average] == [("a", 22.5)]


def test_what_is_not_defined_is_not_a_number(make_run):
    rows = table_rows([make_run(policy="a", accuracy_cm=None), make_run(policy="b", accuracy_cm=3.0)])
    assert rows[0].cells["accuracy_cm"].text(2) == "n/a" and not rows[0].cells["accuracy_cm"].best
    assert rows[1].cells["accuracy_cm"].best


def test_the_overview_marks_ranks_within_a_scene(make_run):
    cells = [(scene, policy) for scene in ("room", "box") for policy in ("a|b", "c")]
    runs = [make_run(scene, policy, psnr=20.0 + (policy == "c")) for scene, policy in cells]
    one = markdown(overview(table_rows(runs[:2]), COLUMNS))
    header, rule, first, second = one.splitlines()
    assert header.startswith("| policy | Acc (cm) ↓ | Com. (cm) ↓ | C.R. (%) ↑ | C.R. surface (%) ↑ | observed (%) ↑ |")
    assert rule.count("|") == header.count("|")
    assert "a\\|b" in first and "**21.00** ¹" in second and "20.00 ²" in first
    table = overview(table_rows(runs), COLUMNS)
    assert [row[0].text for row in table.rows] == ["room", "room", "box", "box", AVERAGE, AVERAGE]
    assert list(table.blocks) == [2, 4]


def test_csv_has_every_number_in_full(make_run):
    runs = [make_run(psnr=float(np.pi)), make_run(policy="b", accuracy_cm=None)]
    first, second = csv.DictReader(io.StringIO(runs_csv(runs)))
    assert float(first["psnr"]) == np.pi and first["job"] == runs[0].job.hash and first["protocol"] == "standard"
    assert second["accuracy_cm"] == "" and float(second["seconds"]) == 10.0
    assert float(first["seconds_mapping"]) == 4.0 and float(first["seconds_planning"]) == 1.0
    assert "views" not in first


def test_csv_has_a_column_for_every_swept_field(make_run):
    runs = [make_run(swept={"n": 3, "noise": "kinect"}, psnr=21.0), make_run(swept={"n": 4, "noise": "none"})]
    first, second = csv.DictReader(io.StringIO(runs_csv(runs)))
    assert (first["n"], first["noise"], first["psnr"], first["policy"]) == ("3", "kinect", "21.0", runs[0].policy)
    assert (second["n"], second["noise"], second["seconds"]) == ("4", "none", "10.0")


def test_csv_and_chosen_columns_name_further_protocols(make_run):
    runs = [make_run(psnr=20.0, tsdf_accuracy_cm=2.0), make_run(seed=1)]
    runs[0].protocols["offline"] = {"parameters": {}, "metrics": {"psnr": 30.5, "views": [], "notes": {}}}
    first, second = csv.DictReader(io.StringIO(runs_csv(runs)))
    assert (first["psnr"], first["offline/psnr"], second["offline/psnr"]) == ("20.0", "30.5", "")
    assert "offline/views" not in first and "offline/notes" not in first
    keys = ("psnr", "offline/psnr", "accuracy_cm", "tsdf_accuracy_cm")
    headers = [column.header for column in chosen_columns(keys, runs).columns]
    assert headers == ["PSNR", "PSNR, offline", "Acc", "Acc, tsdf"]


def test_csv_has_an_lpips_that_was_measured_later(tmp_path):
    place = write_run(tmp_path / "run")
    run = read_run(place)
    numbers = {**run.metrics["metrics"], "lpips": 0.25, "lpips_weights": "sums", "notes": {}}
    write_evaluation(place, run.job.conditions.protocol.parameters(), "", numbers)
    (row,) = csv.DictReader(io.StringIO(runs_csv([read_run(place)])))
    assert row["lpips"] == "0.25" and float(row["psnr"]) == run.metrics["metrics"]["psnr"]


@pytest.mark.parametrize("width", [40, 300])
def test_a_narrow_terminal_cuts_no_number(make_run, width):
    out = io.StringIO()
    rows = table_rows([make_run(policy="a[b]", seed=seed, psnr=20.0 + seed) for seed in range(2)])
    print_whole(Console(file=out, width=width), rich_table(rows, COLUMNS, title="title"))
    assert "20.50 ± 0.71" in out.getvalue() and "a[b]" in out.getvalue() and "…" not in out.getvalue()


def test_the_list_of_runs_names_scenes_without_their_places(make_run):
    run = make_run("/home/somebody/house.glb?units=cm", "=evil()")
    (row,) = csv.DictReader(io.StringIO(runs_csv([run])))
    assert (row["scene"], row["policy"], row["scene_hash"]) == ("house?units=cm", "'=evil()", run.job.scene_hash[:16])
