"""What is half-written has a hidden name, and is removed where nobody writes it any more."""

import os

from activestructure_gym.evaluation.archive import temporary
from activestructure_gym.evaluation.machine.processes import machine_id


def test_what_a_killed_process_left_is_removed_and_what_a_living_one_writes_is_not(tmp_path):
    here = machine_id()
    dead = tmp_path / f".one.part-{here}-999999999"  # above the largest process id of Linux
    living = tmp_path / f".one.part-{here}-{os.getpid()}"
    foreign = tmp_path / f".one.part-abcdef-{os.getpid()}"  # a machine of a cluster, whose supervisor is gone
    result = tmp_path / "one"
    for directory in (dead, living, foreign, result):
        directory.mkdir()
    temporary.remove_leftovers(tmp_path)
    assert {entry.name for entry in tmp_path.iterdir()} == {living.name, "one"}


def test_what_a_killed_report_left_is_removed_by_the_next(tmp_path):
    left = tmp_path / f".files-abc.part-{machine_id()}-999999999"
    left.mkdir()
    with temporary.atomic_files(tmp_path) as part:
        (part / "report.html").touch()
        assert not left.exists() and part.is_dir()
    assert [entry.name for entry in tmp_path.iterdir()] == ["report.html"]


def test_a_report_leaves_the_folders_of_others_alone(tmp_path):
    theirs = [".disk.part-1", f".one.part-{machine_id()}-999999999", f".files-x.part-abcdef-{os.getpid()}"]
    old = tmp_path / ".files-y.part-abcdef-1"
    for name in (*theirs, old.name):
        (tmp_path / name).mkdir()
        (tmp_path / name / "data.bin").touch()
    os.utime(old, (1e9, 1e9))
    with temporary.atomic_files(tmp_path) as part:
        (part / "report.html").touch()
    assert {entry.name for entry in tmp_path.iterdir()} == {*theirs, "report.html"}
    assert all((tmp_path / name / "data.bin").exists() for name in theirs)
