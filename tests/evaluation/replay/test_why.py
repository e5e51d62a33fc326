"""Why a view was chosen: rows by rank, their features, the truth, and what others would have chosen."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation import Conditions, compare
from activestructure_gym.evaluation.archive.decisions import BEST
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.replay import why
from activestructure_gym.evaluation.replay.why import explain
from activestructure_gym.specs import Spec

SMALL = Conditions(preset="fast", frame_budget=40, protocol=StandardProtocol(views=2, surface_samples=2000))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("why")
    return compare(["box"], ["hole_area"], folder / "runs", conditions=SMALL, engine="inline").runs[0]


@pytest.fixture
def no_replay(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make a replay fail."""

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("the run is played again")

    monkeypatch.setattr(why, "replay_env", refuse)


@pytest.mark.usefixtures("no_replay")
def test_a_decision_is_explained_from_the_files_alone(run: Run) -> None:
    last = len(run.steps) - 1
    found = explain(run, last)
    assert found.frame == run.steps[-2]["frames"] and found.candidates == run.steps[last]["candidates"]
    best = found.rows[0]
    assert best.rank == 1 and best.row == run.steps[last]["action"] and best.chosen_by == ("hole_area",)
    assert best.features["hole_area"] == pytest.approx(run.steps[last]["features"]["hole_area"])
    assert best.metres == run.steps[last]["view"]["path_length"]
    assert found.trace["hole_area"] == pytest.approx(best.features["hole_area"])
    assert [row.rank for row in found.rows] == list(range(1, min(BEST, found.candidates) + 1))
    scores = [row.score for row in found.rows]
    assert scores == sorted(scores, reverse=True)
    for row in found.rows:
        assert row.score == pytest.approx(row.terms["hole_area"] * row.terms["× travel"])
    assert found.reason.startswith("Chosen for ")
    assert all(row.new_m2 is None for row in found.rows)
    assert explain(run, 0).frame == 1


def test_the_truth_and_other_policies_are_played(run: Run) -> None:
    last = len(run.steps) - 1
    found = explain(run, last, ["random", "pixel_only"], truth=True)
    assert not found.divergence
    assert {name for row in found.rows for name in row.chosen_by} == {"hole_area", "random", "pixel_only"}
    assert all(row.new_m2 is None or row.new_m2 >= 0.0 for row in found.rows) and found.rows[0].new_m2 is not None
    assert [row.row for row in found.rows if row.rank] == [row.row for row in explain(run, last).rows]
    for row in found.rows:
        assert (row.rank is None) == (row.score is None) and list(row.features) == ["hole_area"]
    assert max(row.new_m2 or 0.0 for row in explain(run, 0, truth=True).rows) > 0.1


def test_a_replay_that_offers_other_views_is_reported(run: Run) -> None:
    moved = [[replace(row, view=row.view | {"x": row.view["x"] + 1.0}) for row in rows] for rows in run.decisions or ()]
    other = replace(run)
    other.__dict__["decisions"] = moved
    assert "the replay offers other views" in explain(other, 0, truth=True).divergence


def test_features_of_other_policies_are_left_out(tmp_path: Path) -> None:
    conditions = Conditions(preset="fast", frame_budget=2, protocol=SMALL.protocol)
    (run,) = compare(["box"], ["fisherrf"], tmp_path / "runs", conditions=conditions, engine="inline").runs
    assert list(explain(run, 0, ["fisherrf_path"]).rows[0].features) == ["fisherrf"]


def test_what_cannot_be_explained(run: Run) -> None:
    for decision in (-1, len(run.steps)):
        with pytest.raises(InputError, match="there is no decision"):
            explain(run, decision)
    with pytest.raises(InputError, match="unknown policy"):
        explain(run, 0, ["hole_aera"])
    without = replace(run)
    without.__dict__["decisions"] = None
    with pytest.raises(InputError, match="lacks decisions.npz"):
        explain(without, 0)


@pytest.mark.usefixtures("no_replay")
def test_code_that_a_run_names_is_not_imported_unless_trusted(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "loaded_by_why.py").write_text("raise RuntimeError('imported')\n")
    monkeypatch.syspath_prepend(tmp_path)
    other = replace(run, job=replace(run.job, policy=Spec("loaded_by_why:Mine")))
    assert explain(other, 0).rows  # from the files alone
    with pytest.raises(InputError, match="config.json' names the policy .* add --trust-code"):
        explain(other, 0, ["random"])


def test_asg_why(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["why", str(run.directory), "--decision", "0", "--policies", "random", "--truth"]) == 0
    said = capsys.readouterr().out
    assert "decision 0, frame 1" in said and "new m²" in said and "policy: hole_area" in said
    assert "Chosen for " in said
    assert main(["why", str(run.directory), "--json"]) == 0
    said = capsys.readouterr().out
    content = json.loads(said[said.index("{") :])
    assert content["decision"] == len(run.steps) - 1 and content["rows"][0]["rank"] == 1
    assert main(["why", str(run.directory), "--decision", "999"]) == 2


def test_a_run_in_a_world_has_no_truth_to_show(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    world = "world:simulated?scene=box&width=48&height=36"
    conditions = Conditions(preset="fast", frame_budget=20)
    (run,) = compare([world], ["hole_area"], tmp_path / "runs", conditions=conditions, engine="inline").runs
    found = explain(run, 0, ["random"])
    assert all(row.new_m2 is None for row in found.rows)
    assert main(["why", str(run.directory), "--truth"]) == 0
    said = capsys.readouterr().out
    assert "no ground truth" in said and "new m²" not in said
