"""A comparison with metrics of one's own: they are stored, described and shown, and their code is trusted by nobody."""

import csv
import dataclasses
import json
import sys

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import store
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import Job, refuse_code
from activestructure_gym.evaluation.archive.plugin_code import KEY
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.report.summary import write_results
from activestructure_gym.evaluation.report.tables.columns import overview_columns, own_absences, value_of
from activestructure_gym.evaluation.running.api import compare
from activestructure_gym.evaluation.running.measuring import measure_played

CODE = """
from activestructure_gym.evaluation import Metric

def count(context):
    assert context.path.keyframes.shape[1:] == context.trajectory.shape[1:] == (4, 4)
    assert context.truth.surface.points.shape[1] == 3 and context.ground_truth.scene.name == "box-0"
    return context.gaussians.count + context.numbers["frames"]

counted = Metric("counted", best="lowest", label="count", unit="1", digits=1, meaning="frames too", compute=count)
broken = Metric("broken", best="highest", compute=lambda context: 1 / 0)
"""
CONDITIONS = Conditions(
    preset="fast",
    frame_budget=2,
    protocol=StandardProtocol(views=1, surface_samples=2000, points_source="means"),
    metrics=("own_metrics_of_a_test:counted", "own_metrics_of_a_test:broken"),
)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("own")
    (folder / "own_metrics_of_a_test.py").write_text(CODE)
    sys.path.insert(0, str(folder))
    try:
        result = compare(["box"], ["random"], folder / "out", conditions=CONDITIONS, engine="inline")
        yield result.runs[0]
    finally:
        sys.path.remove(str(folder))


def test_values_descriptions_and_code_are_stored(run):
    numbers = run.metrics["metrics"]
    assert numbers["counted"] == numbers["gaussians"] + numbers["frames"]
    assert numbers["broken"] is None and "broken" not in numbers["notes"]
    described = {one["name"]: one for one in run.metrics["own_metrics"]}
    assert described["counted"]["unit"] == "1" and "reason" not in described["counted"]
    assert described["broken"]["reason"] == "ZeroDivisionError: division by zero"
    assert set(run.config[KEY]) == {f"metric {name}" for name in CONDITIONS.metrics}
    store.read_all(store.read_run(run.directory))


def test_tables_and_files_show_it_like_any_other(run, tmp_path):
    titles = [column.title for column in overview_columns([run])]
    assert titles[-5:] == ["broken ↑", "count (1) ↓", "frames", "path (m)", "time (s)"]
    assert own_absences([run]) == ["broken: n/a in 1 of 1 run, ZeroDivisionError: division by zero"]
    values = {name: value for name, value in run.metrics["metrics"].items() if name != "counted"}
    other = dataclasses.replace(run, metrics={**run.metrics, "metrics": values, "own_metrics": []})
    assert own_absences([other, run])[-1] == "counted: n/a in 1 of 2 runs, not measured there"
    write_results(tmp_path, Results([run], []))
    (row,) = csv.DictReader((tmp_path / "results.csv").open())
    assert float(row["counted"]) == value_of(run, "counted") and row["broken"] == ""
    summary = (tmp_path / "summary.md").read_text()
    assert "| count (1) ↓ |" in summary and "- count: frames too." in summary
    assert "broken is left out: ZeroDivisionError: division by zero." in summary
    assert "count" in (tmp_path / "report.html").read_text()


def test_a_description_that_no_table_could_show_is_damage(run, tmp_path):
    content = json.loads((run.directory / store.METRICS).read_text())
    content["own_metrics"][0]["best"] = "up"
    from activestructure_gym.evaluation.archive import run_files

    with pytest.raises(ValueError, match="best of the metric"):
        run_files.check_metrics(content, "")
    content["own_metrics"][0]["best"], content["metrics"]["broken"] = "lowest", "much"
    with pytest.raises(ValueError, match="metrics.broken: expected a number"):
        run_files.check_metrics(content, "")


def test_conditions_without_metrics_are_those_of_before():
    assert "metrics" not in Conditions().as_dict()
    again = Conditions.from_dict(CONDITIONS.as_dict())
    assert again == CONDITIONS
    assert Job("box", "random", 0, conditions=again).hash != Job("box", "random", 0).hash


def test_a_file_may_not_name_a_metric_s_code(run, monkeypatch):
    with pytest.raises(InputError, match="names the metric 'own_metrics_of_a_test:broken'.*add --trust-code"):
        refuse_code([run.job], "compare.json")
    monkeypatch.setenv("ASG_TRUST_CODE", "1")
    refuse_code([run.job], "compare.json")


def test_a_played_episode_is_not_measured_by_code_that_is_not_trusted(run, monkeypatch, tmp_path):
    from activestructure_gym.evaluation.archive import played

    monkeypatch.setattr(played, "played_episode", lambda directory: run.directory)
    monkeypatch.setattr(played, "job_of", lambda place: run.job)
    with pytest.raises(InputError, match="names the metric"):
        measure_played(tmp_path)
