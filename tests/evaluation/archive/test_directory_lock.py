"""Who may write into a comparison's directory."""

import os
import signal
import subprocess
import sys
import time

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import directory_lock
from activestructure_gym.evaluation.archive.directory_lock import check_free, hold
from activestructure_gym.evaluation.running.output_directory import check_output

pytestmark = pytest.mark.skipif(os.name != "posix", reason="locks of another kind")

# Holds the directory, with a worker that inherits the hold, says who they are, and waits.
HOLDER = """
import subprocess, sys, time
from pathlib import Path
from activestructure_gym.evaluation.archive.directory_lock import hold
with hold(Path(sys.argv[1])) as held:
    sleep = [sys.executable, "-c", "import time; time.sleep(60)"]
    worker = subprocess.Popen(sleep, pass_fds=(held,), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    print(worker.pid, flush=True)
    time.sleep(60)
"""


@pytest.fixture
def holder(tmp_path):
    """A supervisor, and the process id of its worker."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([os.getcwd(), *sys.path])}
    command = [sys.executable, "-c", HOLDER, str(tmp_path / "out")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        worker = int(process.stdout.readline())
        yield process, worker
        process.kill()
        try:
            os.kill(worker, signal.SIGKILL)
        except ProcessLookupError:
            pass


def test_the_second_is_told_who_the_first_is_and_leaves_all_as_it_is(holder, tmp_path):
    process, _ = holder
    place = tmp_path / "out"
    before = (place / directory_lock.LOCK).read_bytes()
    for attempt in (
        lambda: hold(place).__enter__(),
        lambda: check_free(place),
        lambda: check_output(place, resume=True),
    ):
        with pytest.raises(InputError, match=f"process {process.pid} is at work in '.*out'"):
            attempt()
    assert (place / directory_lock.LOCK).read_bytes() == before


def test_the_hold_of_a_killed_supervisor_ends_with_its_last_worker(holder, tmp_path, monkeypatch):
    process, worker = holder
    process.kill()
    process.wait()
    monkeypatch.setattr(directory_lock, "_PATIENCE", 0.3)
    with pytest.raises(
        InputError, match=f"process {process.pid} was killed, but runs that it started are still active"
    ):
        check_free(tmp_path / "out")
    monkeypatch.setattr(directory_lock, "_PATIENCE", 30.0)
    began = time.monotonic()
    os.kill(worker, signal.SIGKILL)
    with hold(tmp_path / "out"):
        assert time.monotonic() - began < 10


def test_a_hold_ends_with_its_block(tmp_path):
    for _ in range(2):
        with hold(tmp_path / "deep" / "out"):
            pass
    check_free(tmp_path / "deep" / "out")
    check_free(tmp_path / "nowhere")
    assert not (tmp_path / "nowhere").exists()


def test_a_daemon_that_a_run_has_left_behind_does_not_keep_the_hold(tmp_path):
    with hold(tmp_path / "out") as held:
        left_behind = os.dup(held)  # as a fork has it
    try:
        check_free(tmp_path / "out")
    finally:
        os.close(left_behind)


def test_another_machine_is_not_waited_for(holder, tmp_path):
    (tmp_path / "out" / directory_lock.LOCK).write_text("1 abcdef")
    with pytest.raises(InputError, match="a process of another machine is at work"):
        check_free(tmp_path / "out")


def test_an_output_that_cannot_be_made():
    from pathlib import Path

    with pytest.raises(InputError, match="cannot be made"), hold(Path("/proc/no_such_place")):
        pass


def test_a_comparison_killed_before_its_record_was_written_stands_in_nobodys_way(tmp_path):
    with hold(tmp_path):
        (tmp_path / ".compare.json.123.tmp").touch()
    check_output(tmp_path, resume=False)
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(InputError, match="other files"):
        check_output(tmp_path, resume=False)
