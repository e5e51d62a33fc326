"""Links inside a comparison: a run that was moved is repeated, and nothing is written where a foreign link leads."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import completion, store, temporary
from activestructure_gym.evaluation.archive.directory_lock import LOCK, hold
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.running.engines.base import LOGS
from activestructure_gym.evaluation.running.output_directory import check_output
from activestructure_gym.evaluation.running.resuming import review_finished
from tests.evaluation.written_runs import write_comparison, write_run

ARCHIVED = Job("room", "random", 0, scene_hash="ab" * 32)
KEPT = "not ours"


def content_of(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """A folder of somebody else."""
    folder = tmp_path / "foreign"
    folder.mkdir()
    (folder / "file").write_text(KEPT)
    return folder


@pytest.fixture
def comparison(tmp_path: Path) -> Path:
    return write_comparison(tmp_path / "all", [ARCHIVED])


def test_a_run_that_was_moved_and_is_damaged_is_made_again_in_its_place(comparison: Path, tmp_path: Path) -> None:
    place, larger = comparison / completion.JOBS / ARCHIVED.name, tmp_path / "larger disk"
    place.rename(larger)
    place.symlink_to(larger)
    assert store.damage_of(place, ARCHIVED) is None
    (larger / store.METRICS).write_text("x")
    before = content_of(larger)
    told: list[str] = []
    review_finished([ARCHIVED], {ARCHIVED.name}, comparison, told.append)
    assert "counts as not finished" in told[0] and not completion.is_done(place, ARCHIVED)
    with completion.atomic_directory(place) as part:
        for file in write_run(tmp_path / "again", ARCHIVED).iterdir():
            file.rename(part / file.name)
    assert store.damage_of(place, ARCHIVED) is None and not place.is_symlink()
    assert content_of(larger) == before  # nothing was deleted through the link, its mark included


@pytest.mark.parametrize("kind", ["foreign", "dangling", "loop", "file", "link to a file"])
def test_whatever_has_a_runs_name_is_replaced_itself(
    comparison: Path, foreign: Path, tmp_path: Path, kind: str
) -> None:
    place = comparison / completion.JOBS / ARCHIVED.name
    place.rename(tmp_path / "before")
    targets = {"foreign": foreign, "dangling": tmp_path / "nowhere", "loop": place, "link to a file": foreign / "file"}
    place.write_text("x") if kind == "file" else place.symlink_to(targets[kind])
    assert not completion.is_done(place, ARCHIVED)
    review_finished([ARCHIVED], {ARCHIVED.name}, comparison, pytest.fail)
    with completion.atomic_directory(place) as part:
        for file in write_run(tmp_path / "again", ARCHIVED).iterdir():
            file.rename(part / file.name)
    assert store.damage_of(place, ARCHIVED) is None and not place.is_symlink()
    assert content_of(foreign) == {"file": KEPT.encode()}


def test_a_withdrawn_run_behind_a_link_stays_as_it_is(comparison: Path, tmp_path: Path) -> None:
    place = comparison / completion.JOBS / ARCHIVED.name
    place.rename(tmp_path / "elsewhere")
    place.symlink_to(tmp_path / "elsewhere")
    completion.withdraw(place)
    assert not place.exists() and (tmp_path / "elsewhere" / completion.DONE).is_file()


@pytest.mark.parametrize("name", [LOCK, LOGS, store.TABLES])
@pytest.mark.parametrize("kind", ["foreign", "dangling", "loop"])
def test_a_comparison_with_foreign_links_is_not_gone_on_with(
    comparison: Path, foreign: Path, tmp_path: Path, name: str, kind: str
) -> None:
    target = {"foreign": foreign / "file" if name == LOCK else foreign, "dangling": tmp_path / "nowhere"}
    (comparison / name).symlink_to(target.get(kind, comparison / name))
    with pytest.raises(InputError, match=f"{name}' is a link, and nothing is written through it"):
        check_output(comparison, resume=True)
    if name == LOCK:
        with pytest.raises(InputError, match="is a link"), hold(comparison):
            pass
    assert content_of(foreign) == {"file": KEPT.encode()} and not (tmp_path / "nowhere").exists()


def test_a_report_writes_through_no_link(comparison: Path, foreign: Path) -> None:
    for name in ("report.html", "summary.md", "results.csv"):
        (comparison / name).symlink_to(foreign / "file")
    with temporary.atomic_files(comparison) as part:
        for name in ("report.html", "summary.md", "results.csv"):
            (part / name).write_text("ours")
    assert all((comparison / name).read_text() == "ours" for name in ("report.html", "summary.md", "results.csv"))
    (comparison / store.TABLES).symlink_to(foreign)
    with pytest.raises(InputError, match="tables' is a link"), temporary.atomic_files(comparison) as part:
        (part / store.TABLES).mkdir()
        (part / store.TABLES / "overview.csv").write_text("ours")
    assert content_of(foreign) == {"file": KEPT.encode()}


def test_evaluations_and_marks_are_not_written_through_links(comparison: Path, foreign: Path) -> None:
    run = comparison / completion.JOBS / ARCHIVED.name
    (run / store.EVALUATIONS).symlink_to(foreign)
    with pytest.raises(InputError, match="evaluations' is a link"):
        store.write_evaluation(run, {"name": "activegamer"}, "", {})
    (run / store.EVALUATIONS).unlink()
    (run / store.EVALUATIONS).mkdir()
    (run / store.EVALUATIONS / "activegamer.json").symlink_to(foreign / "file")
    store.write_evaluation(run, {"name": "activegamer"}, "", {})
    mark = (run / completion.DONE).read_bytes()
    (foreign / "mark").write_bytes(mark)
    (run / completion.DONE).unlink()
    (run / completion.DONE).symlink_to(foreign / "mark")
    completion.withdraw(run)
    completion.set_aside(run)
    assert content_of(foreign) == {"file": KEPT.encode(), "mark": mark}


def test_a_comparison_may_be_a_link_itself_and_so_may_its_runs(comparison: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(comparison)
    (comparison / completion.JOBS).rename(tmp_path / "larger disk")
    (comparison / completion.JOBS).symlink_to(tmp_path / "larger disk")
    for directory in (comparison, tmp_path / "link"):
        check_output(directory, resume=True)
        assert [mark.parent.name for mark in completion.completion_markers(directory)] == [ARCHIVED.name]
    (comparison / completion.JOBS).unlink()
    for target in (tmp_path / "nowhere", comparison / completion.JOBS):
        (comparison / completion.JOBS).symlink_to(target)
        with pytest.raises(InputError, match="jobs' is a link that leads to no folder"):
            check_output(comparison, resume=True)
        (comparison / completion.JOBS).unlink()
    (tmp_path / "link").unlink()
    os.symlink(tmp_path / "link", tmp_path / "link")
    with pytest.raises(InputError, match="is a link that leads nowhere"):
        check_output(tmp_path / "link", resume=False)
