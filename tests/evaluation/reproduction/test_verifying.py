"""A run that is played again comes out the same, and what was changed in one does not."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation import StandardProtocol, compare, read_run
from activestructure_gym.evaluation.archive import json_files, store
from activestructure_gym.evaluation.archive.completion import DONE
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.store import Run, write_evaluation
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.machine.hardware import code_checksum, hardware, versions
from activestructure_gym.evaluation.protocols import get_protocol
from activestructure_gym.evaluation.reproduction.verifying import (
    Verification,
    altered_evaluations,
    remeasured_evaluations,
    verify,
)
from activestructure_gym.npz import read_npz, write_npz


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Run]:
    """The same episode by two policies."""
    result = compare(
        ["box"],
        ["random", "pixel_only"],
        tmp_path_factory.mktemp("made") / "runs",
        conditions=Conditions(
            preset="fast",
            frame_budget=12,
            overrides={"mapper.iterations": 1, "sensor": {"width": 64, "height": 36}},
            protocol=replace(StandardProtocol(), views=1, view_width=64, view_height=36, surface_samples=2000),
        ),
        engine="inline",
    )
    first, second = result.runs
    return first, second


@pytest.fixture(scope="module")
def made(both: tuple[Run, Run]) -> Run:
    return both[0]


@pytest.fixture
def run(made: Run, tmp_path: Path) -> Run:
    """A copy that may be changed."""
    return read_run(Path(shutil.copytree(made.directory, tmp_path / "runs" / "jobs" / made.directory.name)))


def change(run: Run, name: str, act: Any, *, forge: bool = False) -> Run:
    """``run`` with a file that ``act`` made something else of; forged, the checksums are of that."""
    path = run.directory / name
    path.write_bytes(act(path.read_bytes()))
    if forge:
        done, digest = run.directory / DONE, hashlib.sha256(path.read_bytes()).hexdigest()
        lines = [f"{digest}  {name}" if line.endswith(f"  {name}") else line for line in done.read_text().splitlines()]
        done.write_text("\n".join(lines) + "\n")
        return read_run(run.directory)
    return run


def seal(run: Run) -> Run:
    """``run`` with checksums of whatever its files hold now."""
    (run.directory / DONE).unlink()
    store.finish(run.directory, run.job)
    return read_run(run.directory)


def edited(run: Run, name: str, act: Callable[[Any], object]) -> Run:
    """``run`` with another content of a JSON file, written and sealed as we do."""
    content = json.loads((run.directory / name).read_bytes())
    act(content)
    json_files.write_json(run.directory / name, content)
    return seal(run)


def claimed(run: Run) -> Run:
    """``run`` as if it were played on another processor."""
    return edited(run, "timing.json", lambda content: content["hardware"].update(processor="another one"))


@pytest.fixture
def as_made(made: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the play by the true run, so that the comparison alone is tested."""

    def played(job: Any, directory: Path, notify: Any, world: Any) -> Run:
        return replace(made, directory=Path(shutil.copytree(made.directory, directory)))

    monkeypatch.setattr("activestructure_gym.evaluation.reproduction.verifying.run_job", played)


def better(data: bytes) -> bytes:
    content = json.loads(data)
    content["metrics"]["psnr"] += 5.0
    return json.dumps(content).encode()


def test_an_untouched_run_is_identical(run: Run) -> None:
    heard: list[str] = []
    found = verify(run, lambda progress: heard.append(progress.stage))
    assert found == Verification("identical") and "exploring" in heard
    assert run.config["versions"]["code"] == code_checksum()


@pytest.mark.parametrize(
    "name", ["metrics.json", "steps.jsonl", "map.npz", "trajectory.npz", "pictures.npz", "graph.npz", "decisions.npz"]
)
def test_one_changed_byte_is_refused_with_the_files_name(run: Run, name: str) -> None:
    def turned(data: bytes) -> bytes:
        middle = len(data) // 2
        return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]

    found = verify(change(run, name, turned))
    assert found.verdict == "damaged" and name in found.why[0]


def test_numbers_that_were_forged_with_their_sums_do_not_come_out(run: Run) -> None:
    forged = change(run, "metrics.json", better, forge=True)
    found = verify(forged)
    assert found.verdict == "differs" and "metrics.json" in found.why[0]
    assert any(why.startswith("psnr ") for why in found.why)


def test_numbers_of_a_further_protocol_must_come_out_too(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    numbers: dict[str, Any] = {"psnr": 20.0, "lpips": None, "views": [], "notes": {"lpips": "no weights"}}
    again, forged, partial, more, none = (
        replace(run, directory=tmp_path / name) for name in ("again", "forged", "partial", "more", "none")
    )
    other = "another one of the same constants"
    for one, changed in (
        (again, {}), (forged, {"psnr": 30.0}), (partial, {"lpips": 0.5, "notes": {}}), (more, {"f_score": 99.0}),
    ):  # fmt: skip
        one.directory.mkdir()
        write_evaluation(one.directory, {"name": "activegamer", "version": 1}, other, numbers | changed)
    wrong = ["evaluations/activegamer.json"]
    assert remeasured_evaluations(again, again) == ([], [])
    assert remeasured_evaluations(forged, again)[0] == remeasured_evaluations(more, again)[0] == wrong
    assert remeasured_evaluations(none, again)[0] == wrong
    found, unmeasured = remeasured_evaluations(partial, again)
    assert not found and "LPIPS cannot be measured here" in unmeasured[0]
    # Measured later: the protocol's numbers of the map that was made again count.
    measuring = "activestructure_gym.evaluation.reproduction.verifying.measure_again"
    monkeypatch.setattr(measuring, lambda again, protocol: numbers)
    parameters = get_protocol("activegamer").parameters()
    for one, changed in ((again, {}), (forged, {"psnr": 30.0})):
        write_evaluation(one.directory, parameters, other, numbers | changed)
    assert remeasured_evaluations(replace(again), replace(none)) == ([], [])
    assert remeasured_evaluations(replace(forged), replace(none)) == (wrong, [])
    write_evaluation(again.directory, {"name": "activegamer", "version": 99}, other, numbers)
    found, unmeasured = remeasured_evaluations(replace(again), replace(none))
    assert not found and "cannot be measured here" in unmeasured[0]


def test_an_evaluation_of_the_runs_own_protocol_adds_an_lpips_and_nothing_else(run: Run) -> None:
    numbers = {"psnr": 20.0, "f_score": None, "lpips": None, "views": [{"psnr": 20.0}], "notes": {"lpips": "none"}}
    one = replace(run, metrics={"metrics": numbers})
    for changed, said in (
        ({}, []),
        ({"lpips": 0.5, "lpips_weights": "sums", "views": [{"psnr": 20.0, "lpips": 0.5}], "notes": {}}, []),
        ({"f_score": 99.0}, ["evaluations/standard.json has another f_score than metrics.json"]),
    ):
        write_evaluation(run.directory, run.job.conditions.protocol.parameters(), "", numbers | changed)
        assert altered_evaluations(replace(one)) == said
    found = verify(run)
    assert found.verdict == "damaged" and found.why[0].startswith("evaluations/standard.json has another psnr, ")


def test_an_lpips_is_confirmed_only_where_it_can_be_measured(
    run: Run, as_made: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def with_lpips(value: float) -> Callable[[Any], None]:
        def act(content: Any) -> None:
            content["metrics"]["lpips"] = value
            content["metrics"]["notes"].pop("lpips", None)
            for view in content["metrics"]["views"]:
                view["lpips"] = value

        return act

    def later(value: float) -> None:
        content = json.loads(json.dumps({"metrics": run.metrics["metrics"]}))
        with_lpips(value)(content)
        write_evaluation(run.directory, run.job.conditions.protocol.parameters(), "", content["metrics"])

    unmeasured = ("its LPIPS cannot be measured here, as the weights are missing",)
    whole = (run.directory / "metrics.json").read_bytes()
    assert verify(run).verdict == "identical"
    found = verify(edited(run, "metrics.json", with_lpips(0.25)))
    assert (found.verdict, found.why) == ("not comparable here", unmeasured)
    (run.directory / "metrics.json").write_bytes(whole)
    later(0.25)
    assert (verify(seal(run)).verdict, verify(run).why) == ("not comparable here", unmeasured)

    def measured_here(job: Any, directory: Path, notify: Any, world: Any) -> Run:
        shutil.copytree(run.directory, directory)
        return edited(replace(run, directory=directory), "metrics.json", with_lpips(0.25))

    monkeypatch.setattr("activestructure_gym.evaluation.reproduction.verifying.run_job", measured_here)
    assert (verify(run).verdict, verify(run).why) == ("identical", ())
    later(0.5)
    found = verify(run)
    assert (found.verdict, found.why[0]) == ("differs", "other bytes in evaluations/standard.json")
    (run.directory / store.EVALUATIONS / "standard.json").unlink()
    assert verify(edited(run, "metrics.json", with_lpips(0.5))).verdict == "differs"


FORGED_NUMBERS: dict[str, float] = {
    "f_score": 99.0, "tsdf_f_score": 99.0, "tsdf_precision": 99.9, "ms_ssim": 0.999, "metres": 0.1, "frames_to_80": 5.0,
    "gaussians": 10, "keyframes": 99, "collisions": 7, "observed_area": 99.0, "frames": 11, "decisions": 77,
    "late_psnr_rate": 9.0, "true_area_m2": 1.0, "view_coverage": 0.99,
}  # fmt: skip


@pytest.mark.parametrize("name", FORGED_NUMBERS)
def test_one_forged_number_is_never_confirmed(run: Run, as_made: None, name: str) -> None:
    def forge(content: Any) -> None:
        assert name in content["metrics"] and content["metrics"][name] != FORGED_NUMBERS[name]
        content["metrics"][name] = FORGED_NUMBERS[name]

    assert verify(edited(run, "metrics.json", forge)).verdict in ("differs", "damaged")
    found = verify(claimed(run))
    # Only what neither the files nor the map contradict is left open.
    assert found.verdict in (("not comparable here",) if name == "collisions" else ("differs", "damaged")), found
    assert name in " ".join(found.why).lower()


def at_the_edge(content: Any) -> None:
    """Better by as much as two processors were allowed to differ by."""
    for name, by in {"psnr": 0.49, "completion_ratio": 0.99, "tsdf_completion_ratio": 0.99, "observed": 0.99}.items():
        content["metrics"][name] += by


def steep(content: Any) -> None:
    for point in content["curve"]:
        point |= {"completion_ratio": 99.0, "psnr": 40.0}


def more_views(content: Any) -> None:
    content["metrics"]["views"].append(content["metrics"]["views"][0])


@pytest.mark.parametrize("forge", [at_the_edge, steep, more_views])
def test_numbers_and_curves_better_than_the_map_are_refuted_on_any_processor(
    run: Run, as_made: None, forge: Callable[[Any], None]
) -> None:
    assert verify(edited(run, "metrics.json", forge)).verdict in ("differs", "damaged")
    assert verify(claimed(run)).verdict in ("differs", "damaged")


_OF_THE_PLAY = (store.MAP, store.TRAJECTORY, store.PICTURES, store.GRAPH, store.STEPS, store.DECISIONS)


@pytest.mark.parametrize("names", [(name,) for name in (*_OF_THE_PLAY, store.PLY)] + [_OF_THE_PLAY])
def test_files_of_another_run_are_never_confirmed(
    run: Run, both: tuple[Run, Run], as_made: None, names: tuple[str, ...]
) -> None:
    for name in names:
        shutil.copy(both[1].directory / name, run.directory / name)
    found = verify(seal(run))
    assert found.verdict in ("differs", "damaged")
    found = verify(claimed(run))
    assert found.verdict in ("differs", "damaged", "not comparable here")
    assert store.MAP not in names or found.verdict != "not comparable here"  # whose numbers are others


def test_a_whole_other_run_under_this_job_is_not_confirmed(run: Run, both: tuple[Run, Run], as_made: None) -> None:
    for name in (*_OF_THE_PLAY, store.PLY, store.METRICS, "timing.json"):
        shutil.copy(both[1].directory / name, run.directory / name)
    rows = read_npz(run.directory / store.DECISIONS)  # this job has no features
    write_npz(run.directory / store.DECISIONS, {**rows, "features": rows["features"][:, :0]})
    found = verify(seal(run))
    assert found.verdict == "differs" and "other bytes in metrics.json, steps.jsonl, " in found.why[0]
    found = verify(claimed(run))  # it agrees with itself: only its processor could tell
    assert found.verdict == "not comparable here" and found.why[0].startswith("made on another one, played again on ")
    assert any(why.startswith("tsdf_completion_ratio ") and ", again " in why for why in found.why), found


def test_another_processor_neither_hinders_nor_excuses(run: Run, as_made: None) -> None:
    assert verify(claimed(run)).verdict == "identical"  # it may be slower and reach the same bytes

    def last_digit(content: Any) -> None:  # as another processor rounds
        content["metrics"]["psnr"] *= 1.0 + 1e-15

    found = verify(edited(run, "metrics.json", last_digit))
    assert found.verdict == "not comparable here" and "other bytes in metrics.json" in found.why
    assert verify(edited(run, "timing.json", lambda c: c["hardware"].update(hardware()))).verdict == "differs"

    def older(content: Any) -> None:
        content["versions"]["numpy"] = "1.0"

    assert verify(edited(run, "config.json", older)).why[0] == f"numpy was 1.0, is {versions()['numpy']}"


def test_a_file_that_says_a_number_twice_is_not_identical(run: Run, as_made: None) -> None:
    def twice(data: bytes) -> bytes:
        return data.replace(b'"psnr":', b'"psnr": 99.0,\n  "psnr":', 1)

    assert verify(change(run, "metrics.json", twice, forge=True)).verdict == "differs"


def test_what_no_processor_rounds_must_come_out_elsewhere_too(run: Run, as_made: None) -> None:
    claimed(run)
    found = verify(edited(run, "config.json", lambda content: content["configuration"].update(frame_budget=2000)))
    assert found.verdict == "differs" and "another config.json of the same code" in found.why


def test_the_map_for_viewers_may_be_deleted(run: Run, as_made: None) -> None:
    (run.directory / store.PLY).unlink()
    assert verify(run).verdict == "identical"


def test_a_file_without_a_sum_is_no_verified_one(run: Run) -> None:
    done = run.directory / DONE
    done.write_text("".join(line for line in done.read_text().splitlines(True) if "metrics.json" not in line))
    found = verify(read_run(run.directory))
    assert found.verdict == "damaged" and "no checksum of metrics.json" in found.why[0]


def test_a_run_that_cannot_be_played_says_so(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    playing = "activestructure_gym.evaluation.reproduction.verifying.verify"
    monkeypatch.setattr(playing, lambda run, notify: Verification("identical"))
    assert main(["verify", str(run.directory)]) == 0
    assert "box · random · seed 0: identical" in capsys.readouterr().out
    assert main(["verify"]) == 2 and main(["verify", str(tmp_path / "nothing")]) == 2

    def raising(run: Run, notify: Any) -> None:
        raise RuntimeError("a policy's own")

    monkeypatch.setattr(playing, raising)
    assert main(["verify", str(run.directory)]) == 1
    out = capsys.readouterr().out
    assert "cannot be played here: RuntimeError: a policy's own" in out and "1 of 1 could not be played" in out
    assert "differs" not in out and "did not come out" not in out  # nothing is known of it


def test_code_is_not_run_for_who_hands_in_a_run(run: Run) -> None:
    named = replace(run.job, policy="tests.policies.test_native_settings:Bringer")
    content = {**run.config, "job": named.as_dict(), "hash": named.hash}
    json_files.write_json(run.directory / store.CONFIG, content)
    store.finish(run.directory, named)
    with pytest.raises(InputError, match="names the policy .* add --trust-code"):
        verify(read_run(run.directory))
