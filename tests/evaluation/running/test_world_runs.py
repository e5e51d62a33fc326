"""Runs in a world without ground truth: played, stored, interrupted, continued, reported, replayed."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.evaluation import Conditions, compare
from activestructure_gym.evaluation.archive.comparison import open_comparison
from activestructure_gym.evaluation.archive.store import CAPTURES, Run, read_run
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.replay.recording import play_again
from activestructure_gym.evaluation.report.page.scene_section import seed_text
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.reproduction.remeasure import measure_again
from activestructure_gym.evaluation.reproduction.verifying import verify
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.registry import TRUST
from activestructure_gym.worlds import CaptureFailed
from activestructure_gym.worlds.simulated_world import SimulatedRobot

WORLD = "world:simulated?scene=box&width=48&height=36"
SMALL = Conditions(preset="fast", frame_budget=40)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Run]:
    """Two policies in one world."""
    folder = tmp_path_factory.mktemp("world")
    return compare([WORLD], ["unknown_volume", "random"], folder / "runs", conditions=SMALL, engine="inline").runs


def test_no_number_is_invented(runs: list[Run]) -> None:
    for run in runs:
        numbers = run.metrics["metrics"]
        assert not run.has_truth and run.config["scene"]["notes"] == ["no ground truth"]
        for name in ("completion_ratio", "psnr", "observed", "accuracy_cm", "tsdf_completion_ratio", "collisions"):
            assert numbers[name] is None, name
        assert numbers["notes"]["psnr"] == "no ground truth" and numbers["views"] == []
        assert numbers["known_m3"] > 1.0 and 5.0 < numbers["keyframe_psnr"] < 60.0
        assert [point["known_m3"] for point in run.metrics["curve"]][-1] == numbers["known_m3"]
        assert all(point["completion_ratio"] is None for point in run.metrics["curve"])
        assert len(list((run.directory / CAPTURES).glob("*.npz"))) == numbers["keyframes"]


def test_the_report_says_that_there_is_no_ground_truth(runs: list[Run], capsys: pytest.CaptureFixture[str]) -> None:
    folder = runs[0].directory.parent.parent
    assert main(["report", str(folder)]) == 0
    page = (folder / "report.html").read_text(encoding="utf-8")
    said = "No ground truth: Acc, Com., C.R., C.R. surface, observed, Prec., F, PSNR"
    assert said in page and not any(words in page for words in ("steps through the", "true surface", "median C.R."))
    assert "steps through the" not in (folder / "tables" / "costs.csv").read_text(encoding="utf-8")
    assert "known" in page and "captured view" in page and "known volume [m³]" in page
    assert said in (folder / "summary.md").read_text(encoding="utf-8")
    assert "known" in capsys.readouterr().out


def test_a_metric_does_not_replace_a_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = "from activestructure_gym.evaluation import Metric\n"
    code += "".join(f"{name} = Metric('{name}', best='lowest', compute=len)\n" for name in ("frames", "counted"))
    (tmp_path / "metrics_of_a_world_test.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    names = tuple(f"metrics_of_a_world_test:{name}" for name in ("frames", "counted"))
    conditions = Conditions(preset="fast", frame_budget=2, metrics=names)
    with pytest.warns(InputWarning, match="'frames' is left out"):
        (run,) = compare([WORLD], ["random"], tmp_path / "runs", conditions=conditions, engine="inline").runs
    assert run.metrics["metrics"]["frames"] == 2 and run.metrics["metrics"]["counted"] is None
    assert run.metrics["own_metrics"][-1]["reason"] == "no ground truth"


def test_a_world_is_released_if_its_episode_cannot_begin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    closed = list[SimulatedRobot]()
    monkeypatch.setattr(SimulatedRobot, "close", lambda self: closed.append(self))
    monkeypatch.setattr("activestructure_gym.reconstruction.episode.checked_start", _refused)
    result = compare([WORLD], ["random"], tmp_path / "runs", conditions=SMALL, engine="inline")
    assert "start is refused" in result.failed[0].error and closed


def _refused(*_: Any) -> Any:
    raise InputError("the start is refused")


def test_the_seed_of_the_images_is_chosen_by_known_volume(runs: list[Run]) -> None:
    less = {"known_m3": 0.5}
    others = [
        replace(run, job=replace(run.job, seed=1), metrics=run.metrics | {"metrics": run.metrics["metrics"] | less})
        for run in runs
    ]
    text = seed_text(Results([*runs, *others], ()), runs[0].scene)
    assert "of seed 1, so" in text and "median known volume" in text


def test_a_run_is_replayed_and_verified_from_its_captures(runs: list[Run], monkeypatch: pytest.MonkeyPatch) -> None:
    def untouched(*_: Any) -> Any:
        raise AssertionError("the robot must not move")

    monkeypatch.setattr("activestructure_gym.evaluation.running.surroundings.load_world", untouched)
    assert verify(runs[0]).verdict == "identical"
    recording = play_again(runs[0])
    assert not recording.divergence and len(recording.moments) == len(runs[0].steps) + 1
    with pytest.raises(InputError, match="without ground truth"):
        measure_again(runs[0], SMALL.protocol)


def test_a_stopped_run_continues_from_its_captures(
    runs: list[Run], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken = list[np.ndarray]()

    def failing(self: SimulatedRobot, wanted: np.ndarray) -> Frame:
        if len(taken) >= 2:
            raise CaptureFailed("the battery is empty")
        return normal(self, wanted)

    def normal(self: SimulatedRobot, wanted: np.ndarray) -> Frame:
        taken.append(wanted)
        self._pose = wanted
        return self._sensor.capture(wanted)

    monkeypatch.setattr(SimulatedRobot, "capture", failing)
    given: dict[str, Any] = {"conditions": SMALL, "engine": "inline"}
    result = compare([WORLD], ["unknown_volume"], tmp_path / "runs", **given)
    assert "battery" in result.failed[0].error and len(taken) == 2
    monkeypatch.setattr(SimulatedRobot, "capture", normal)
    (run,) = compare([WORLD], ["unknown_volume"], tmp_path / "runs", resume=True, **given).runs
    assert len(taken) == run.metrics["metrics"]["keyframes"]
    whole = next(one for one in runs if one.policy == "unknown_volume")
    assert run.metrics == whole.metrics
    np.testing.assert_array_equal(run.trajectory["world_from_camera"], whole.trajectory["world_from_camera"])
    assert not (tmp_path / "runs" / CAPTURES / run.directory.name).exists()


def test_a_run_without_its_captures_says_so(runs: list[Run], tmp_path: Path) -> None:
    place = Path(shutil.copytree(runs[0].directory, tmp_path / "run"))
    shutil.rmtree(place / CAPTURES)
    with pytest.raises(InputError, match="holds no captures to replay"):
        play_again(read_run(place))


@pytest.mark.parametrize(
    ("conditions", "policies", "message"),
    [
        (Conditions(preset="fast", also=("activegamer",)), ["random"], "protocol activegamer needs"),
        (Conditions(preset="fast", start_pose=(1.0, 1.0, 1.0, 0.0)), ["random"], "the start pose"),
        (SMALL, ["trajectory:sweep"], "trajectory"),
    ],
)
def test_what_needs_ground_truth_is_refused_before_anything_moves(
    conditions: Conditions, policies: list[str], message: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        compare([WORLD], policies, tmp_path / "runs", conditions=conditions, engine="inline")
    with pytest.raises(InputError, match="unknown option 'colour' of world 'simulated'"):
        compare([f"{WORLD}&colour=red"], ["random"], tmp_path / "runs", conditions=SMALL, engine="inline")
    with pytest.raises(InputError, match="tries of a world must be a whole number of at least 1, got 0"):
        compare([f"{WORLD}&tries=0"], ["random"], tmp_path / "runs", conditions=SMALL, engine="inline")


def test_asg_explore(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["explore", "--world", WORLD.removeprefix("world:"), "--policy", "random", "--frames", "20"]
    assert main([*words, "--preset", "fast", "--out", str(tmp_path / "runs")]) == 0
    said = capsys.readouterr().out
    assert "No ground truth: Acc" in said and "asg watch --world" in said
    (run,) = open_comparison(tmp_path / "runs")
    assert run.policy == "random" and run.metrics["metrics"]["frames"] == 20
    assert main(["explore", "--resume", "--out", str(tmp_path / "runs")]) == 0
    assert main(["explore", "--resume", "--out", str(tmp_path / "typo")]) == 2
    assert "give --world" in capsys.readouterr().err
    assert main(["explore", "--out", str(tmp_path / "other")]) == 2
    assert "--world names the world" in capsys.readouterr().err


def test_asg_explore_says_how_to_go_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    take, taken = SimulatedRobot.capture, list[np.ndarray]()

    def empty(self: SimulatedRobot, wanted: np.ndarray) -> Frame:
        if len(taken) >= limit:
            raise CaptureFailed("the battery is empty")
        taken.append(wanted)
        return take(self, wanted)

    monkeypatch.setattr(SimulatedRobot, "capture", empty)
    for limit, kept in ((0, False), (1, True)):
        place = str(tmp_path / f"runs-{limit}")
        code = main(["explore", "--world", "simulated?scene=box", "--preset", "fast", "--out", place])
        assert code == 1 and ("asg explore --out" in capsys.readouterr().err) == kept
    # The command of a world of one's own is complete.
    (tmp_path / "my_robot.py").write_text("from activestructure_gym.worlds.simulated_world import SimulatedRobot\n")
    monkeypatch.syspath_prepend(tmp_path)
    limit, place = len(taken) + 1, str(tmp_path / "own")
    monkeypatch.setenv(TRUST, "0")  # which the command below sets for this process
    words = ["explore", "--world", "my_robot:SimulatedRobot?scene=box", "--preset", "fast", "--frames", "20"]
    assert main([*words, "--out", place]) == 1
    command = capsys.readouterr().err.strip().rpartition("continue with: asg ")[2]
    assert command == f"explore --out {place} --resume --trust-code"
    monkeypatch.setattr(SimulatedRobot, "capture", take)
    assert main(command.split()) == 0
