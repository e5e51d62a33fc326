"""A played episode is kept until it is measured, whatever ends measuring."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.evaluation.archive import completion, played, store
from activestructure_gym.evaluation.archive.comparison import open_comparison, run_directory
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.cli.closing import print_end
from activestructure_gym.evaluation.cli.evaluate import Evaluate
from activestructure_gym.evaluation.cli.output import make_console
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.report.pictures import run_figures
from activestructure_gym.evaluation.running import episode, measuring
from activestructure_gym.evaluation.running.api import NullListener
from activestructure_gym.evaluation.running.comparison import Result, run_comparison
from activestructure_gym.scenes import load_scene

CLOCKS = ("timing.json", completion.DONE)  # which holds the checksum of the other


@pytest.fixture(scope="module")
def job() -> Job:
    protocol = StandardProtocol(views=2, view_width=64, view_height=36, surface_samples=1000, tsdf_voxel_m=0.06)
    scene_hash = load_scene("box").content_hash
    return Job(
        "box",
        "random",
        0,
        scene_hash=scene_hash,
        conditions=Conditions(preset="fast", frame_budget=12, protocol=protocol),
    )


@pytest.fixture(scope="module")
def finished(job, tmp_path_factory) -> Path:
    """The run, not interrupted."""
    directory = tmp_path_factory.mktemp("finished") / "run"
    episode.run_job(job, directory)
    return directory


@pytest.fixture(scope="module")
def interrupted(job, finished, tmp_path_factory) -> Path:
    """The same run, of which measuring has failed."""
    directory = tmp_path_factory.mktemp("interrupted") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measuring, "_write_clocks", _disk_is_full)
        with pytest.raises(OSError, match="No space left"):
            episode.run_job(job, directory)
    return directory


@pytest.fixture
def kept(interrupted, tmp_path) -> Path:
    return Path(shutil.copytree(interrupted, tmp_path / "kept"))


def _disk_is_full(*given: object) -> None:
    raise OSError(28, "No space left on device")


def _never_again(*given: object) -> None:
    raise AssertionError("it was played again")


def _check_equal(one: Path, other: Path) -> None:
    files = sorted(path.relative_to(one) for path in one.rglob("*") if path.is_file())
    assert files == sorted(path.relative_to(other) for path in other.rglob("*") if path.is_file())
    for file in files:
        assert file.name in CLOCKS or (one / file).read_bytes() == (other / file).read_bytes(), file
    clocks = [json.loads((place / "timing.json").read_text()) for place in (one, other)]
    assert clocks[0].keys() == clocks[1].keys() and clocks[0]["seconds"].keys() == clocks[1]["seconds"].keys()


def test_what_was_played_is_kept_and_is_no_finished_run(kept, job):
    names = {path.name for path in kept.iterdir()}
    assert {"config.json", "steps.jsonl", "trajectory.npz", "map.npz", "map.ply", "graph.npz", "decisions.npz"} <= names
    assert completion.DONE not in names and not completion.is_done(kept, job) and played.is_played(kept)
    with pytest.raises(InputError, match="was played but not measured; `asg evaluate .*` measures it"):
        store.read_run(kept)
    assert sorted(path.name for path in kept.parent.iterdir()) == [kept.name]


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError, SystemExit, InputError])
def test_whatever_ends_measuring_the_episode_stays_and_is_not_played_again(error, kept, finished, job, monkeypatch):
    monkeypatch.setattr(episode, "_play", _never_again)
    with monkeypatch.context() as patch:
        patch.setattr(StandardProtocol, "evaluate", lambda *given: (_ for _ in ()).throw(error("now")))
        with pytest.raises(error):
            episode.run_job(job, kept)
    assert played.is_played(kept)
    run = episode.run_job(job, kept)
    assert run.job == job and not played.is_played(kept)
    _check_equal(finished, kept)


def test_an_episode_is_found_where_a_kill_left_it_between_two_names(kept, finished, job, monkeypatch):
    monkeypatch.setattr(episode, "_play", _never_again)
    kept.rename(completion.aside_of(kept))
    assert played.is_played(kept)
    episode.run_job(job, kept)
    _check_equal(finished, kept)
    assert not completion.aside_of(kept).exists()


@pytest.mark.parametrize("name", ["map.npz", "episode.json", "steps.jsonl", "plan.npz", ".played"])
def test_a_damaged_episode_is_played_again(name, kept, finished, job):
    content = bytearray((kept / name).read_bytes())
    content[len(content) // 2] ^= 1
    (kept / name).write_bytes(content)
    assert played.played_episode(kept, job) is None
    if name == "map.npz":
        episode.run_job(job, kept)
        _check_equal(finished, kept)


def test_an_episode_of_another_job_or_of_other_code_does_not_count(kept, job):
    assert played.played_episode(kept, job) == kept
    assert played.played_episode(kept, replace(job, seed=1)) is None
    own = replace(job, policy="mine:Mine")
    (kept / completion.PLAYED).write_text((kept / completion.PLAYED).read_text().replace(job.hash, own.hash))
    assert played.played_episode(kept, own, lambda module: None) == kept
    assert played.played_episode(kept, own, lambda module: "ab") == kept  # of which the run has no sum
    config = json.loads((kept / "config.json").read_text()) | {"own_code": {"policy mine:Mine": "cd"}}
    (kept / "config.json").write_text(json.dumps(config))
    completion.write_marker(kept, completion.PLAYED, own, played._READ)
    assert played.played_episode(kept, own, lambda module: "cd") == kept
    assert played.played_episode(kept, own, lambda module: "ab") is None


def test_a_process_that_was_slower_leaves_the_finished_run_alone(finished, job, tmp_path):
    place = Path(shutil.copytree(finished, tmp_path / "run"))
    mark = (place / completion.DONE).read_bytes()
    with played.written_episode(place, job) as part:
        (part / "config.json").write_text("{}")
    assert (place / completion.DONE).read_bytes() == mark and not (place / completion.PLAYED).exists()


def test_evaluate_measures_an_episode_and_finishes_its_run(kept, finished, capsys, monkeypatch):
    monkeypatch.setattr(episode, "_play", _never_again)
    assert Evaluate(runs=(str(kept),)).run() == 0
    assert "1 run finished" in capsys.readouterr().out
    _check_equal(finished, kept)


def test_a_picture_that_fails_does_not_fail_the_run(kept, finished, job, monkeypatch):
    def half_drawn(run: store.Run, directory: Path) -> None:
        assert completion.is_done(run.directory, job)
        (directory / "views.png").touch()
        raise ValueError("no font")

    monkeypatch.setattr(run_figures, "draw_run", half_drawn)
    with pytest.warns(InputWarning, match="no pictures of box · random · seed 0: no font"):
        episode.run_job(job, kept)
    _check_equal(finished, kept)


def test_pictures_that_a_killed_process_has_not_drawn_are_drawn_once(finished, tmp_path, monkeypatch):
    drawn = list[Path]()

    def draw(run: store.Run, directory: Path) -> None:
        drawn.append(run.directory)
        (directory / run_figures.VIEWS).touch()

    monkeypatch.setattr(run_figures, "draw_run", draw)
    run = store.read_run(shutil.copytree(finished, tmp_path / "run"))
    result = Result([run], [], 0)
    for _ in range(2):
        print_end(make_console(), result, tmp_path, 1.0, None, wide=False)
    assert drawn == [run.directory] and (run.directory / run_figures.VIEWS).exists()


def test_resuming_a_comparison_measures_what_was_played(finished, job, tmp_path, monkeypatch):
    for way in ("resume", "evaluate"):
        directory = tmp_path / way
        directory.mkdir()
        with monkeypatch.context() as patch:
            patch.setattr(measuring, "_write_clocks", _disk_is_full)
            result = run_comparison([job], directory, NullListener(), engine="inline")
        assert [outcome.job for outcome in result.failed] == [job] and not result.runs
        assert open_comparison(directory) == []
        with monkeypatch.context() as patch:
            patch.setattr(episode, "_play", _never_again)
            if way == "resume":
                assert len(run_comparison([job], directory, NullListener(), engine="inline", resume=True).runs) == 1
            else:
                assert Evaluate(runs=(str(directory),)).run() == 0
        _check_equal(finished, run_directory(directory, job))


def test_nothing_is_written_where_links_in_a_played_episode_lead(kept, finished, tmp_path):
    theirs = tmp_path / "theirs"
    theirs.write_text("not ours")
    for name in (store.PICTURES, store.METRICS, "views.png", "timing.json", store.EVALUATIONS, completion.DONE):
        (kept / name).symlink_to(theirs)
    (kept / completion.DONE).unlink()
    measuring.measure_played(kept)
    _check_equal(kept, finished)
    assert theirs.read_text() == "not ours"


def _sealed(place: Path, job: Job, name: str, **changes: np.ndarray) -> Path:
    with np.load(place / name) as file:
        arrays = dict(file) | changes
    np.savez(place / name, **arrays)
    completion.write_marker(place, completion.PLAYED, job, played._READ)
    return place


@pytest.mark.parametrize(
    ("name", "array"), [(played.PLAN, "plan_state"), (played.PLAN, "above_rgb"), (store.TRAJECTORY, "keyframes")]
)
def test_arrays_of_another_width_are_damage(kept, job, name, array):
    with np.load(kept / name) as file:
        wider = file[array].astype("u2")
    with pytest.raises(InputError, match=f"{name}' is damaged: {array}: expected .* its episode is played again"):
        measuring.measure_played(_sealed(kept, job, name, **{array: wider}))


def test_the_rows_of_the_decisions_are_those_of_the_steps_and_equal_however_the_run_was_finished(kept, job, finished):
    written = (kept / "decisions.npz").read_bytes()
    run = episode.run_job(job, kept)
    assert run.decisions is not None and (kept / "decisions.npz").read_bytes() == written
    assert (finished / "decisions.npz").read_bytes() == written
    assert [rows[0].row for rows in run.decisions] == [step["action"] for step in run.steps]
    assert "decisions.npz" in run.checksums and store.without_checksum(run) == []


def test_a_played_episode_with_damaged_rows_is_played_again(kept, job):
    (kept / "decisions.npz").write_bytes(b"damaged")
    assert played.played_episode(kept, job) is None
