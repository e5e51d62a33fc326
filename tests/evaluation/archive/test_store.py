import json
import os

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import store
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.machine.processes import machine_mark

JOB = Job("box", "random", 0)


def test_a_directory_appears_whole(tmp_path):
    target = tmp_path / "jobs" / "one"
    with store.whole_directory(target) as part:
        (part / "file").write_text("content")
        assert not target.exists()
    assert (target / "file").read_text() == "content"
    assert [entry.name for entry in target.parent.iterdir()] == ["one"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_after_an_error_nothing_is_left_and_the_old_stays(tmp_path, error):
    target = tmp_path / "one"
    target.mkdir()
    (target / "old").touch()
    with pytest.raises(error), store.whole_directory(target) as part:
        (part / "new").touch()
        raise error
    assert [entry.name for entry in tmp_path.iterdir()] == ["one"]
    assert [entry.name for entry in target.iterdir()] == ["old"]


def test_what_a_killed_process_left_is_removed_and_what_a_living_one_writes_is_not(tmp_path):
    here = machine_mark()
    dead = tmp_path / f".one.part-{here}-999999999"  # above the largest process id of Linux
    living = tmp_path / f".one.part-{here}-{os.getpid()}"
    foreign = tmp_path / f".one.part-abcdef-{os.getpid()}"  # a machine of a cluster, whose supervisor is gone
    result = tmp_path / "one"
    for directory in (dead, living, foreign, result):
        directory.mkdir()
    store.remove_parts(tmp_path)
    assert {entry.name for entry in tmp_path.iterdir()} == {living.name, "one"}


def test_of_two_processes_with_one_job_the_faster_one_is_kept(tmp_path):
    target = tmp_path / "one"
    for writer in ("first", "second"):
        with store.whole_directory(target) as part:
            (part / "writer").write_text(writer)
            (part / store.DONE).write_text(JOB.hash)
    assert (target / "writer").read_text() == "first"
    with store.whole_directory(target) as part:
        (part / "writer").write_text("another job")
        (part / store.DONE).write_text("another hash")
    assert (target / "writer").read_text() == "another job"


def test_only_the_very_job_counts_as_done(tmp_path):
    assert not store.is_done(tmp_path, JOB)
    (tmp_path / store.DONE).write_text(JOB.hash + "\n")
    assert store.is_done(tmp_path, JOB)
    assert not store.is_done(tmp_path, Job("box", "random", 1))


def test_an_unfinished_directory_cannot_be_read(tmp_path):
    with pytest.raises(InputError, match="not a finished run"):
        store.read_run(tmp_path)
    (tmp_path / store.DONE).write_text("x")
    with pytest.raises(InputError, match="cannot be read as a run"):
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
    store.write_json(tmp_path / "a.json", content)
    assert json.loads((tmp_path / "a.json").read_text()) == {
        "array": [0, 1, 2], "scalar": 0.5, "flag": True, "bad": [None, None], "7": str(tmp_path)
    }  # fmt: skip
    assert store.json_line({"a": [1, np.nan]}) == '{"a":[1,null]}\n'
    with pytest.raises(TypeError, match="object"):
        store.plain(object())
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.json"]


def test_arrays_are_never_unpickled(tmp_path):
    np.savez(tmp_path / "evil.npz", content=np.array([{"a": 1}], dtype=object))
    with pytest.raises(ValueError, match="allow_pickle"):
        store.load_arrays(tmp_path / "evil.npz")
