"""A run that is played again comes out the same, and what was changed in one does not."""

from __future__ import annotations

import hashlib
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation import StandardProtocol, compare, read_run
from activestructure_gym.evaluation.archive import verified
from activestructure_gym.evaluation.archive.store import DONE, Run, write_evaluation
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.cli.options import parse_start
from activestructure_gym.evaluation.machine.hardware import code_sum
from activestructure_gym.evaluation.report.leaderboard import COLUMNS, leaderboard_page, rows_of
from activestructure_gym.evaluation.running.verifying import (
    TOLERANCES,
    other_protocols,
    out_of_tolerance,
    untrue_evaluations,
    verify,
)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Run:
    result = compare(
        ["box"],
        ["random"],
        tmp_path_factory.mktemp("made") / "runs",
        preset="fast",
        frame_budget=12,
        config={"mapper.iterations": 1, "sensor": {"width": 64, "height": 36}},
        engine="inline",
        protocol=replace(StandardProtocol(), views=1, view_width=64, view_height=36, surface_samples=2000),
    )
    return result.runs[0]


@pytest.fixture
def run(made: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """A copy that may be changed, with marks of its own."""
    monkeypatch.setenv(verified.VARIABLE, str(tmp_path / "marks"))
    return read_run(Path(shutil.copytree(made.directory, tmp_path / "runs" / "jobs" / made.directory.name)))


def change(run: Run, name: str, act: Any, *, forge: bool = False) -> Run:
    """``run`` with a file that ``act`` made something else of; forged, the sums are of that."""
    path = run.directory / name
    path.write_bytes(act(path.read_bytes()))
    if forge:
        done, digest = run.directory / DONE, hashlib.sha256(path.read_bytes()).hexdigest()
        lines = [f"{digest}  {name}" if line.endswith(f"  {name}") else line for line in done.read_text().splitlines()]
        done.write_text("\n".join(lines) + "\n")
        return read_run(run.directory)
    return run


def better(data: bytes) -> bytes:
    content = json.loads(data)
    content["metrics"]["psnr"] += 5.0
    return json.dumps(content).encode()


def test_an_untouched_run_is_identical_and_known_from_then_on(run: Run) -> None:
    assert verified.known(run.directory) is None
    heard: list[str] = []
    found = verify(run, lambda progress: heard.append(progress.stage))
    assert (found.verdict, found.why, found.code) == ("identical", (), code_sum()) and "exploring" in heard
    verified.keep(run.directory, found)
    assert verified.known(run.directory) == found
    assert run.config["versions"]["code"] == code_sum()
    # A mark inside the run would be of whoever handed it in.
    assert not any(verified.marks_directory().name in str(file) for file in run.directory.rglob("*"))


@pytest.mark.parametrize(
    "name", ["metrics.json", "steps.jsonl", "map.npz", "trajectory.npz", "pictures.npz", "graph.npz"]
)
def test_one_changed_byte_is_refused_with_the_files_name(run: Run, name: str) -> None:
    def turned(data: bytes) -> bytes:
        middle = len(data) // 2
        return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]

    verified.keep(run.directory, verified.Verification("identical"))
    found = verify(change(run, name, turned))
    assert found.verdict == "damaged" and name in found.why[0]


def test_numbers_that_were_forged_with_their_sums_do_not_come_out(run: Run) -> None:
    verified.keep(run.directory, verified.Verification("identical"))
    forged = change(run, "metrics.json", better, forge=True)
    assert verified.known(run.directory) is None  # it is another run's
    found = verify(forged)
    assert found.verdict == "differs" and "metrics.json" in found.why[0]
    assert any(why.startswith("psnr ") for why in found.why)


def test_numbers_of_a_further_protocol_must_come_out_too(run: Run) -> None:
    numbers = {"psnr": 20.0, "lpips": None, "views": [], "notes": {"lpips": "no weights"}}
    asked = replace(run.job, also=("activegamer",))
    again, forged, partial, none = (
        replace(run, job=asked, directory=run.directory / name) for name in ("again", "forged", "partial", "none")
    )
    for one, changed in ((again, {}), (forged, {"psnr": 30.0}), (partial, {"lpips": 0.5, "notes": {}})):
        one.directory.mkdir()
        write_evaluation(one.directory, {"name": "activegamer", "version": 1}, "", numbers | changed)
    assert other_protocols(again, again) == other_protocols(partial, again) == []  # LPIPS needs weights
    assert other_protocols(forged, again) == other_protocols(none, again) == ["evaluations/activegamer.json"]
    assert other_protocols(replace(forged, job=run.job), again) == []  # measured later: none of the job's


def test_an_evaluation_of_the_runs_own_protocol_adds_an_lpips_and_nothing_else(run: Run) -> None:
    numbers = {"psnr": 20.0, "f_score": None, "lpips": None, "views": [{"psnr": 20.0}], "notes": {"lpips": "none"}}
    one = replace(run, metrics={"metrics": numbers})
    for changed, said in (
        ({}, []),
        ({"lpips": 0.5, "lpips_weights": "sums", "views": [{"psnr": 20.0, "lpips": 0.5}], "notes": {}}, []),
        ({"f_score": 99.0}, ["evaluations/standard.json has another f_score than metrics.json"]),
    ):
        write_evaluation(run.directory, run.job.protocol.parameters(), "", numbers | changed)
        assert untrue_evaluations(replace(one)) == said
    found = verify(run)
    assert found.verdict == "damaged" and found.why[0].startswith("evaluations/standard.json has another psnr, ")


def test_an_lpips_counts_where_it_can_be_measured_and_is_named_where_not(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def with_lpips(value: float) -> Any:
        def act(data: bytes) -> bytes:
            content = json.loads(data)
            content["metrics"]["lpips"] = value
            content["metrics"]["notes"].pop("lpips", None)
            for view in content["metrics"]["views"]:
                view["lpips"] = value
            return json.dumps(content).encode()

        return act

    def later(value: float) -> None:
        content = with_lpips(value)(json.dumps({"metrics": run.metrics["metrics"]}).encode())
        write_evaluation(run.directory, run.job.protocol.parameters(), "", json.loads(content)["metrics"])

    unchecked = ("its LPIPS was not measured again, as the weights are not here",)
    stored = change(run, "metrics.json", with_lpips(0.25), forge=True)
    assert (verify(stored).verdict, verify(stored).why) == ("identical", unchecked)
    untouched = change(run, "metrics.json", lambda _: json.dumps(run.metrics).encode(), forge=True)
    later(0.25)
    assert (verify(untouched).verdict, verify(untouched).why) == ("identical", unchecked)

    def measured_here(job: Any, directory: Path, tell: Any) -> Run:
        shutil.copytree(run.directory, directory)
        return change(replace(run, directory=directory), "metrics.json", with_lpips(0.25), forge=True)

    monkeypatch.setattr("activestructure_gym.evaluation.running.verifying.run_job", measured_here)
    assert (verify(untouched).verdict, verify(untouched).why) == ("identical", ())
    later(0.5)
    found = verify(read_run(run.directory))
    assert (found.verdict, found.why) == ("differs", ("other bytes in evaluations/standard.json",))
    assert verify(change(run, "metrics.json", with_lpips(0.5), forge=True)).verdict != "identical"


def test_elsewhere_numbers_count_within_tolerances(run: Run) -> None:
    def of_another_machine(data: bytes) -> bytes:
        content = json.loads(data)
        content["hardware"]["processor"] = "another one"
        return json.dumps(content).encode()

    def a_little_better(data: bytes) -> bytes:
        content = json.loads(data)
        content["metrics"]["psnr"] += 0.5 * TOLERANCES["psnr"]
        return json.dumps(content).encode()

    other = change(run, "timing.json", of_another_machine, forge=True)
    assert verify(other).verdict == "identical"  # it may be slower and reach the same bytes
    found = verify(change(other, "metrics.json", a_little_better, forge=True))
    assert found.verdict == "within tolerances" and found.why[0].startswith("made on another one, played again on ")
    found = verify(change(other, "metrics.json", better, forge=True))
    assert found.verdict == "differs" and len(found.why) == 2


def test_what_no_processor_rounds_must_come_out_elsewhere_too(run: Run) -> None:
    def of_another_machine(data: bytes) -> bytes:
        content = json.loads(data)
        content["hardware"]["processor"] = "another one"
        return json.dumps(content).encode()

    def longer(data: bytes) -> bytes:
        content = json.loads(data)
        content["configuration"]["frame_budget"] = 2000
        return json.dumps(content).encode()

    change(run, "timing.json", of_another_machine, forge=True)
    found = verify(change(run, "config.json", longer, forge=True))
    assert found.verdict == "differs" and "config.json" in found.why[-1]


def test_every_number_of_the_leaderboard_has_a_tolerance() -> None:
    assert {column.key for column in COLUMNS} <= TOLERANCES.keys()


def test_a_file_without_a_sum_is_no_verified_one(run: Run) -> None:
    done = run.directory / DONE
    done.write_text("".join(line for line in done.read_text().splitlines(True) if "metrics.json" not in line))
    found = verify(read_run(run.directory))
    assert found.verdict == "damaged" and "no sum of metrics.json" in found.why[0]
    verified.keep(run.directory, verified.Verification("identical"))
    assert verified.known(run.directory) is None


def test_of_runs_of_one_job_the_one_that_came_out_stands_on_the_leaderboard(run: Run) -> None:
    forged = replace(run, metrics={**run.metrics, "metrics": {**run.metrics["metrics"], "psnr": 99.0}})
    verdicts: dict[int, verified.Verification] = {id(run): verified.Verification("identical")}
    for runs in ([run, forged], [forged, run]):
        (((row,), _),) = rows_of(runs, lambda one: verdicts.get(id(one)))
        assert row.runs == (run,) and row.status == "verified"
    verdicts = {id(forged): verified.Verification("differs")}
    (((row,), _),) = rows_of([run, forged], lambda one: verdicts.get(id(one)))
    assert row.runs == (forged,) and row.refuted


def test_what_is_not_remembered_or_raises_says_so(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv(verified.VARIABLE, str(tmp_path / "file" / "marks"))
    playing = "activestructure_gym.evaluation.running.verifying.verify"
    monkeypatch.setattr(playing, lambda run, tell: verified.Verification("identical"))
    assert main(["verify", str(run.directory)]) == 0
    told = capsys.readouterr()
    assert "identical" in told.out and "not remembered" in told.err and "cannot be played" not in told.out

    def raising(run: Run, tell: Any) -> None:
        raise RuntimeError("a policy's own")

    monkeypatch.setattr(playing, raising)
    assert main(["verify", str(run.directory)]) == 1
    out = capsys.readouterr().out
    assert "cannot be played here: RuntimeError: a policy's own" in out and "1 of 1 could not be played" in out
    assert "differs" not in out and "did not come out" not in out  # nothing is known of it


def test_tolerances_are_of_both_sides_and_of_numbers_that_both_have() -> None:
    assert out_of_tolerance({"psnr": 20.0, "ssim": None}, {"psnr": 20.5, "ssim": None}) == []
    assert len(out_of_tolerance({"psnr": 20.0}, {"psnr": 19.4})) == 1
    assert out_of_tolerance({"ssim": None}, {"ssim": 0.5}) == ["ssim none, again 0.50, which may differ by 0.02"]


def test_code_is_not_run_for_who_hands_in_a_run(run: Run) -> None:
    with pytest.raises(InputError, match="names the policy .* add --trust-code"):
        verify(replace(run, job=replace(run.job, policy="tests.policies.test_schedule:Bringer")))


def test_a_row_is_self_reported_until_it_was_verified_here(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    directory = str(run.directory)

    def said() -> str:
        ((rows, _),) = rows_of([run], lambda one: verified.known(one.directory))
        return rows[0].status

    assert main(["leaderboard", directory]) == 0
    assert "self-reported" in (tmp_path / "leaderboard.html").read_text() and said() == "self-reported"
    assert main(["verify", directory]) == 0
    assert "box · random · seed 0: identical" in capsys.readouterr().out and said() == "verified"
    assert main(["leaderboard", directory]) == 0
    page = (tmp_path / "leaderboard.html").read_text()
    for text in (run.sums["map.npz"], run.sums["metrics.json"], run.config["scene"]["content_hash"], ">verified<"):
        assert text in page
    assert "asg compare --scenes box --policies random --seeds 0 --preset fast --frames 12 --set" in page
    assert "--views 1 --samples 2000" in page and "--view-source" not in page
    change(run, "metrics.json", better)
    assert main(["verify", directory]) == 1 and "metrics.json" in capsys.readouterr().out
    assert main(["leaderboard", directory]) == 2 and "metrics.json" in capsys.readouterr().err
    assert main(["verify"]) == 2 and main(["leaderboard", str(tmp_path)]) == 2


def test_who_sees_the_ground_truth_leads_no_leaderboard(run: Run) -> None:
    metrics = {**run.metrics, "metrics": {**run.metrics["metrics"], "tsdf_completion_ratio": 99.0}}
    oracle = replace(run, job=replace(run.job, policy="reference:oracle"), metrics=metrics)
    (((first, last), _),) = rows_of([oracle, run], lambda one: None)
    assert (first.policy, last.reference) == ("random", True)
    assert "--references oracle" in last.command and "reference:" not in last.command
    page = leaderboard_page([oracle, run], lambda one: None, {})
    assert "of a reference or of given poses, a row has no rank" in page


def test_a_refuted_row_is_told_to_have_no_rank_for_that(run: Run) -> None:
    other = replace(run, job=replace(run.job, policy="naruto"))
    told = "nor has one of which a run came out otherwise"
    refuted = verified.Verification("differs", ("other bytes in map.npz",))
    assert told in leaderboard_page([run, other], lambda one: refuted if one is other else None, {})
    assert told not in leaderboard_page([run, other], lambda one: None, {})


def test_who_follows_given_poses_leads_no_leaderboard(run: Run) -> None:
    metrics = {**run.metrics, "metrics": {**run.metrics["metrics"], "tsdf_completion_ratio": 99.0}}
    given = replace(run, job=replace(run.job, policy="trajectory:sweep"), metrics=metrics)
    (((first, last), _),) = rows_of([given, run], lambda one: None)
    assert (first.policy, first.plans, last.plans) == ("random", True, False)


def test_who_was_refuted_leads_no_leaderboard(run: Run) -> None:
    metrics = {**run.metrics, "metrics": {**run.metrics["metrics"], "tsdf_completion_ratio": 99.0}}
    forged = replace(run, job=replace(run.job, policy="hole_area"), metrics=metrics)
    verdicts = {forged.policy: verified.Verification("differs"), run.policy: verified.Verification("identical")}
    (((first, last), wanted),) = rows_of([forged, run], lambda one: verdicts[one.policy])
    assert (first.policy, last.policy) == ("random", "hole_area") and wanted == 1
    page = leaderboard_page([forged, run], lambda one: verdicts[one.policy], {})
    assert "refuted" in page and page.index(">random<") < page.index(">hole_area<")


def test_the_command_of_a_row_plays_its_own_jobs_to_the_last_digit(run: Run) -> None:
    start = (0.123456789, -1.0, 1.4, 17.188733853924695)  # as a recorded pose has them
    (((row,), _),) = rows_of([replace(run, job=replace(run.job, start_pose=start))], lambda one: None)
    (said,) = (word for word in row.command.split() if word.startswith("--start="))
    assert parse_start(said.removeprefix("--start=")) == start


def test_who_played_less_is_not_ranked_and_refuted_runs_are_said(run: Run) -> None:
    def other(policy: str, seed: int, ratio: float) -> Run:
        metrics = {**run.metrics, "metrics": {**run.metrics["metrics"], "tsdf_completion_ratio": ratio}}
        return replace(run, job=replace(run.job, policy=policy, seed=seed), metrics=metrics)

    played = [("random", 0, 50.0), ("random", 1, 60.0), ("hole_area", 0, 70.0), ("hole_area", 1, 80.0)]
    runs = [other(*one) for one in (*played, ("frontier", 0, 99.0))]
    runs.append(replace(other("random", 0, 1.0), job=replace(run.job, preset="default")))
    verdicts = {("random", 0): "identical", ("random", 1): "differs", ("hole_area", 0): "within tolerances"}

    def known(one: Run) -> verified.Verification | None:
        verdict = verdicts.get((one.job.policy, one.job.seed)) if one.job.preset == "fast" else None
        return verified.Verification(verdict) if verdict else None  # type: ignore[arg-type]

    (rows, wanted), (others, _) = rows_of(runs, known)
    assert [row.policy for row in rows] == ["hole_area", "frontier", "random"] and wanted == 2
    assert [row.status for row in rows] == [
        "verified 1 of 2 runs, others self-reported, within tolerances",
        "self-reported", "refuted: 1 run came out otherwise",
    ]  # fmt: skip
    assert len(others) == 1
    page = leaderboard_page(runs, known, {"/home/who/runs/<b>": "damaged"})
    assert "<b>&lt;" not in page and "/home/who" not in page and "&lt;b&gt;" in page
