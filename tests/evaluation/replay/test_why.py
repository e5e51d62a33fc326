"""Why a view was chosen: rows by rank, their features, the truth, and what others would have chosen."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation import Conditions, compare
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.replay.why import BEST, explain, ranked_rows
from activestructure_gym.policies import make_policy

SMALL = Conditions(preset="fast", frame_budget=40, protocol=StandardProtocol(views=2, surface_samples=2000))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("why")
    return compare(["box"], ["hole_area"], folder / "runs", conditions=SMALL, engine="inline").runs[0]


def test_a_decision_is_explained(run: Run) -> None:
    last = len(run.steps) - 1
    found = explain(run, last, ["random", "pixel_only"])
    assert not found.divergence and found.frame == run.steps[-2]["frames"] and found.decision == last
    assert found.candidates == run.steps[last]["candidates"]
    best = found.rows[0]
    assert best.rank == 1 and best.row == run.steps[last]["action"] and "hole_area" in best.chosen_by
    assert best.features["hole_area"] == pytest.approx(run.steps[last]["features"]["hole_area"])
    assert found.trace["hole_area"] == pytest.approx(best.features["hole_area"])
    ranks = [row.rank for row in found.rows if row.rank is not None]
    assert ranks == list(range(1, min(BEST, found.candidates) + 1))
    chosen = {name for row in found.rows for name in row.chosen_by}
    assert chosen == {"hole_area", "random", "pixel_only"}
    assert all(row.new_m2 is None or row.new_m2 >= 0.0 for row in found.rows) and best.new_m2 is not None
    first = explain(run, 0)
    assert first.frame == 1 and max(row.new_m2 or 0.0 for row in first.rows) > 0.1


def test_features_of_other_policies_are_left_out(tmp_path: Path) -> None:
    conditions = Conditions(preset="fast", frame_budget=2, protocol=SMALL.protocol)
    (run,) = compare(["box"], ["fisherrf"], tmp_path / "runs", conditions=conditions, engine="inline").runs
    assert list(explain(run, 0, ["fisherrf_path"]).rows[0].features) == ["fisherrf"]


def test_rows_are_ranked_by_asking_again_and_the_policy_does_not_change() -> None:
    policy = make_policy("pixel_only")
    policy.bind(("pixel",))
    observation = {
        "candidates": np.tile(np.array([0, 0, 1, 1, 0, 0, 1.0, 5, 0], np.float32), (4, 1)),
        "candidate_features": np.array([[0.2], [0.9], [0.5], [0.7]], np.float32),
        "action_mask": np.array([1, 1, 1, 0], np.int8),
    }
    assert ranked_rows(policy, observation, 5) == [1, 2, 0]
    assert ranked_rows(policy, observation, 2) == [1, 2]
    assert observation["action_mask"].tolist() == [1, 1, 1, 0]


def test_what_cannot_be_explained(run: Run) -> None:
    for decision in (-1, len(run.steps)):
        with pytest.raises(InputError, match="there is no decision"):
            explain(run, decision)
    with pytest.raises(InputError, match="unknown policy"):
        explain(run, 0, ["hole_aera"])


def test_asg_why(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["why", str(run.directory), "--decision", "0", "--policies", "random"]) == 0
    said = capsys.readouterr().out
    assert "decision 0, frame 1" in said and "new m²" in said and "policy: hole_area" in said
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
    assert main(["why", str(run.directory)]) == 0
    said = capsys.readouterr().out
    assert "no ground truth" in said and "new m²" not in said
