import json
from pathlib import Path

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import completion, json_files, store
from activestructure_gym.evaluation.archive.comparison import open_comparison
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.report.results import gather
from activestructure_gym.evaluation.report.tables.columns import value_of
from activestructure_gym.evaluation.reproduction.remeasure import differing
from tests.evaluation.written_runs import JOB as ARCHIVED
from tests.evaluation.written_runs import write_comparison, write_run

JOB = Job("box", "random", 0)


def test_a_directory_appears_whole(tmp_path):
    target = tmp_path / "jobs" / "one"
    with completion.atomic_directory(target) as part:
        (part / "file").write_text("content")
        assert not target.exists()
    assert (target / "file").read_text() == "content"
    assert [entry.name for entry in target.parent.iterdir()] == ["one"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_after_an_error_nothing_is_left_and_the_old_stays(tmp_path, error):
    target = tmp_path / "one"
    target.mkdir()
    (target / "old").touch()
    with pytest.raises(error), completion.atomic_directory(target) as part:
        (part / "new").touch()
        raise error
    assert [entry.name for entry in tmp_path.iterdir()] == ["one"]
    assert [entry.name for entry in target.iterdir()] == ["old"]


def test_what_is_half_written_is_no_finished_run(tmp_path):
    for name in ("one", ".one.part-here-1"):
        (tmp_path / completion.JOBS / name).mkdir(parents=True)
        (tmp_path / completion.JOBS / name / completion.DONE).touch()
    assert [mark.parent.name for mark in completion.completion_markers(tmp_path)] == ["one"]


def test_what_is_no_finished_run_is_said(tmp_path):
    place = write_comparison(tmp_path / "all", [ARCHIVED])
    (tmp_path / "half").mkdir()
    (tmp_path / "file").touch()
    for name, words in (
        ("all", f"it is a comparison; name one of its 1, as .*{ARCHIVED.name}"), ("half", "it has no .done file"),
        ("file", "it is a file"), ("nowhere", "it does not exist"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=f"{name}' is not a finished run: {words}"):
            store.read_run(tmp_path / name)
    (place / completion.JOBS / ARCHIVED.name / completion.DONE).unlink()
    with pytest.raises(InputError, match="none of whose runs has ended"):
        store.read_run(place)
    with pytest.raises(
        InputError, match="1 run asked for and none at its end, go on with asg compare --out .*all --resume"
    ):
        gather([place])


def test_of_two_processes_with_one_job_the_faster_one_is_kept(tmp_path):
    target = tmp_path / "one"
    for writer in ("first", "second"):
        with completion.atomic_directory(target) as part:
            (part / "writer").write_text(writer)
            (part / completion.DONE).write_text(JOB.hash)
    assert (target / "writer").read_text() == "first"
    with completion.atomic_directory(target) as part:
        (part / "writer").write_text("another job")
        (part / completion.DONE).write_text("another hash")
    assert (target / "writer").read_text() == "another job"


def test_only_the_very_job_counts_as_done(tmp_path):
    assert not completion.is_done(tmp_path, JOB)
    (tmp_path / completion.DONE).write_text(JOB.hash + "\n")
    assert completion.is_done(tmp_path, JOB)
    assert not completion.is_done(tmp_path, Job("box", "random", 1))


def test_an_unfinished_directory_cannot_be_read(tmp_path):
    with pytest.raises(InputError, match="not a finished run"):
        store.read_run(tmp_path)
    (tmp_path / completion.DONE).write_text("x")
    with pytest.raises(InputError, match="config.json' is missing; make the run again"):
        store.read_run(tmp_path)
    for name in ("config", "metrics", "timing"):
        (tmp_path / f"{name}.json").write_text('{"format": 99}')
    with pytest.raises(InputError, match="run format 99"):
        store.read_run(tmp_path)


def test_json_has_no_numpy_and_no_nan(tmp_path):
    content = {
        "array": np.arange(3),
        "scalar": np.float32(0.5),
        "flag": np.bool_(True),
        "bad": [float("nan"), np.inf],
        7: tmp_path,
    }
    json_files.write_json(tmp_path / "a.json", content)
    assert json.loads((tmp_path / "a.json").read_text()) == {
        "array": [0, 1, 2], "scalar": 0.5, "flag": True, "bad": [None, None], "7": str(tmp_path)
    }  # fmt: skip
    assert json_files.json_line({"a": [1, np.nan]}) == '{"a":[1,null]}\n'
    with pytest.raises(TypeError, match="object"):
        json_files.plain(object())
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.json"]


def test_a_finished_run_is_read(tmp_path):
    run = store.read_run(write_run(tmp_path / "run"), "the scene")
    assert (run.scene, run.job) == ("the scene", ARCHIVED)
    assert run.metrics["metrics"]["psnr"] == 20.0 and len(run.steps) == 3 and run.gaussians.count == 0
    assert run.trajectory["world_from_camera"].shape == (20, 4, 4) and len(run.graph["ids"]) == 2
    assert store.damage_of(tmp_path / "run", ARCHIVED) is None
    assert len((tmp_path / "run" / completion.DONE).read_text().splitlines()) == 1 + 9
    assert store.damage_of(write_run(tmp_path / "older", checksums=False), ARCHIVED) is None


READ_AGAIN = (
    "config.json", "metrics.json", "timing.json", "steps.jsonl", "trajectory.npz", "graph.npz", "pictures.npz",
    "map.npz", "decisions.npz",
)  # fmt: skip


@pytest.mark.parametrize("name", READ_AGAIN)
@pytest.mark.parametrize("how", ["flipped", "cut", "emptied", "deleted", "folder"])
def test_damage_names_the_file_and_how_to_get_it_back(name, how, tmp_path):
    place = write_comparison(tmp_path / "a b", [ARCHIVED])
    path = place / completion.JOBS / ARCHIVED.name / name
    content = bytearray(path.read_bytes())
    if how == "flipped":
        content[len(content) // 2] ^= 1
    path.unlink()
    if how == "folder":
        path.mkdir()
    elif how != "deleted":
        path.write_bytes({"flipped": content, "cut": content[: len(content) // 2], "emptied": b""}[how])
    message = store.damage_of(path.parent, ARCHIVED)
    assert message is not None and len(message.splitlines()) == 1
    assert message.startswith(f"'{path}' is {'missing' if how == 'deleted' else 'damaged'}")
    assert message.endswith(f"; `asg compare --out '{place}' --resume` repeats the run")


def deep(value):
    for _ in range(500):
        value = [value]
    return value


@pytest.mark.parametrize(
    "name, place, value, words",
    [
        ("config", "job", 3, "job: expected a table"),
        ("config", "job.seed", -1, "job.seed: expected a whole number"),
        ("config", "job.policy", "a\nb", "line break"),
        ("config", "job.protocol.views", 1e9, "views"),
        ("config", "job.protocol.version", 99, "version 99"),
        ("config", "job.more", 1, "a job of this version has no more"),
        ("config", "scene.extent_m", [1, 2], "scene.extent_m: expected 3 entries"),
        ("config", "scene", None, "scene: expected a table"),
        ("config", "versions", {}, "versions lacks activestructure-gym"),
        ("config", "configuration.more", deep(1), "nested deeper"),
        ("config", "hash", "0" * 12, "it belongs to job 000000000000"),
        ("metrics", "metrics.psnr", None, "metrics.psnr: expected a number, got None"),
        ("metrics", "metrics.psnr", float("nan"), "holds NaN"),
        ("metrics", "metrics.views", [3], r"metrics.views\[0\]: expected a table"),
        ("metrics", "metrics.notes", [], "metrics.notes: expected a table"),
        ("metrics", "curve", [], "curve: expected at least 1"),
        ("metrics", "curve", [{}], r"curve\[0\] lacks decision, frames"),
        ("timing", "decisions", ["a"], r"decisions\[0\]: expected a number"),
        ("timing", "hardware", None, "hardware: expected a table"),
    ],
)
def test_a_json_file_that_holds_something_else(name, place, value, words, tmp_path):
    run = write_run(tmp_path / "run", checksums=False)
    content = json.loads((run / f"{name}.json").read_text())
    *outer, last = place.split(".")
    inner = content
    for key in outer:
        inner = inner[key]
    inner[last] = value
    (run / f"{name}.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=words) as error:
        store.read_run(run)
    assert f"{name}.json' is damaged" in str(error.value) and len(str(error.value).splitlines()) == 1


def poses(**changes):
    content = np.tile(np.eye(4), (20, 1, 1))
    content[changes.pop("at", 0)] = changes.pop("pose", np.eye(4))
    return content


@pytest.mark.parametrize(
    "name, changes, words",
    [
        ("trajectory", {"world_from_camera": poses()[:0]}, "world_from_camera: expected"),
        ("trajectory", {"world_from_camera": poses(at=3, pose=2 * np.eye(4))}, "not rigid poses"),
        ("trajectory", {"keyframes": np.array([0, 5, 10, 20])}, "holds an index beyond the 20 poses"),
        ("trajectory", {"image_size": np.array([16000, 9])}, "not a plausible image size"),
        ("trajectory", {"intrinsics": np.zeros(4)}, "focal lengths"),
        ("pictures", {"psnr": np.zeros(3)}, "psnr: expected 4"),
        ("pictures", {"plan_state": np.full((3, 3), 7, np.uint8)}, "plan_state holds numbers outside"),
        ("pictures", {"plan_extent": np.array([0.0, 1.0])}, "plan_extent holds numbers outside"),
        (
            "decisions",
            {
                "starts": np.array([0, 2, 4]),
                "scored": np.ones(2, bool),
                "rows": np.array([0, 1, 0, 1]),
                "scores": np.ones(4),
                "views": np.zeros((4, 9), np.float32),
                "features": np.zeros((4, 0), np.float32),
            },
            "decisions",
        ),
        ("graph", {"edges": np.array([[0, 2]])}, "edges holds an index beyond the 2 planes"),
        ("graph", {"normals": np.zeros((2, 3))}, "not of length 1"),
        ("graph", {"patch_shapes": np.array([[40, 30], [21, 10]])}, "do not fit together"),
        ("graph", {"patch_starts": np.array([0])}, "do not fit together"),
    ],
)
def test_arrays_that_do_not_fit(name, changes, words, tmp_path):
    run = write_run(tmp_path / "run", checksums=False)
    with np.load(run / f"{name}.npz") as file:
        content = dict(file)
    np.savez(run / f"{name}.npz", **content | changes)
    assert store.damage_of(run, ARCHIVED) is not None
    with pytest.raises(InputError, match=f"{name}.npz' is damaged: .*{words}"):
        getattr(store.read_run(run), name)


def test_decisions_that_do_not_follow_each_other(tmp_path):
    run = write_run(tmp_path / "run", checksums=False)
    lines = (run / store.STEPS).read_text().splitlines(keepends=True)
    for text, words in (("".join(lines[::-1]), "frames decrease"), (lines[0] + "{}\n", "line 2 lacks frames"),
                        (lines[0] + "{\n", "line 2: it is not JSON")):  # fmt: skip
        (run / store.STEPS).write_text(text)
        with pytest.raises(InputError, match=f"steps.jsonl' is damaged: {words}"):
            _ = store.read_run(run).steps


def test_a_further_evaluation_that_is_damaged_can_be_made_again(tmp_path):
    run = write_run(tmp_path / "run")
    (run / store.EVALUATIONS).mkdir()
    (run / store.EVALUATIONS / "activegamer.json").write_text("{}")
    with pytest.raises(InputError, match="delete it, and `asg evaluate .* --protocols activegamer` measures it again"):
        _ = store.read_run(run).protocols


def test_lpips_measured_later_completes_the_runs_own_numbers(tmp_path):
    place = write_run(tmp_path / "run")
    run = store.read_run(place)
    own = run.metrics["metrics"]
    views = [{**view, "lpips": 0.3} for view in own["views"]]
    later = {**own, "lpips": 0.3, "lpips_weights": "sums", "views": views, "notes": {}}
    assert value_of(run, "lpips") is None
    store.write_evaluation(place, run.job.conditions.protocol.parameters(), "", later)
    run = store.read_run(place)
    assert run.protocols["standard"]["metrics"] == later and value_of(run, "lpips") == 0.3
    assert differing(run.protocols["standard"]["metrics"], later) == []  # a second evaluation finds nothing else


def test_no_other_number_is_filled_in_by_an_evaluation_beside_the_run(tmp_path):
    place = write_run(tmp_path / "run")
    content = json.loads((place / "metrics.json").read_text())
    content["metrics"]["tsdf_completion_ratio"] = None
    (place / "metrics.json").write_text(json.dumps(content))
    store.finish(place, ARCHIVED)
    own = store.read_run(place).metrics["metrics"]
    forged = {**own, "tsdf_completion_ratio": 99.0, "invented": 1.0}
    for views, lpips in ((own["views"], 0.3), (own["views"][1:], None)):  # an LPIPS of other views is none of the run's
        store.write_evaluation(
            place, ARCHIVED.conditions.protocol.parameters(), "", {**forged, "lpips": 0.3, "views": views}
        )
        run = store.read_run(place)
        assert value_of(run, "tsdf_completion_ratio") is None and "invented" not in run.numbers
        assert run.numbers["tsdf_completion_ratio"] is None and value_of(run, "lpips") == lpips


def test_the_completion_marker_of_another_job_is_damage(tmp_path):
    place = write_comparison(tmp_path / "all", [ARCHIVED])
    (place / completion.JOBS / ARCHIVED.name / completion.DONE).write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="done' is damaged: it belongs to another job .* --resume` repeats the run"):
        open_comparison(place)
    (place / completion.JOBS / ARCHIVED.name / completion.DONE).unlink()
    assert open_comparison(place) == []


def test_the_working_directory_can_be_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert completion.aside_of(Path(".")) == tmp_path.with_name(f".{tmp_path.name}.aside")


def test_the_root_directory_is_no_run() -> None:
    assert completion.aside_of(Path("/")) == Path("/..aside")
