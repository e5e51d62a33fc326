"""What a worker leaves behind: processes, threads, and the words about how it ended."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.machine.processes import is_alive
from activestructure_gym.evaluation.running.engines import process
from activestructure_gym.evaluation.running.engines.base import LOGS, Limits
from activestructure_gym.evaluation.running.engines.failure_text import error_text, failure_text
from activestructure_gym.evaluation.running.engines.local import run_local
from tests.evaluation.running.engines.test_local import Recorder

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks processes up in /proc")

# Leaves a child behind that keeps all descriptors open, as a library that forks does.
FORKS = """
import json, os, pathlib, sys, time
policy = json.loads(sys.stdin.readline())["policy"]
directory = pathlib.Path(sys.argv[1])

def tell(frames):  # one write, which PYTHONUNBUFFERED would make two of print's: another process's could come between
    sys.stdout.write(json.dumps({"stage": "exploring", "frames": frames}) + "\\n")
    sys.stdout.flush()

child = os.fork()
if child == 0:
    if "daemon" in policy:
        os.setsid()
    if "talks" in policy:
        while True:
            tell(99)
            time.sleep(0.05)
    time.sleep(60)
while "daemon" in policy and os.getsid(child) != child:
    time.sleep(0.01)  # until it has its own session, it ends with this run
(directory.parent.parent / "child").write_text(str(child))
if "hangs" in policy:
    time.sleep(60)
tell(5)
directory.mkdir(parents=True)
(directory / ".done").write_text(directory.name.rpartition("--")[2])
"""


@pytest.fixture
def child(tmp_path):
    """The number of the process that was left behind; it is ended afterwards."""
    yield lambda: int((tmp_path / "child").read_text())
    try:
        os.kill(int((tmp_path / "child").read_text()), signal.SIGKILL)
    except (FileNotFoundError, ProcessLookupError):
        pass


@pytest.mark.parametrize("policy", ["forks", "forks-talks"])
def test_a_run_ends_with_its_process_and_ends_what_that_has_started(tmp_path, child, policy):
    began, listener = time.monotonic(), Recorder()
    (outcome,) = run_local([Job("box", policy, 0)], tmp_path, listener, Limits(), command=("-c", FORKS))
    assert outcome.finished and (policy, 5) in listener.frames and time.monotonic() - began < 20
    assert not lives(child())
    (log,) = (tmp_path / LOGS).iterdir()
    told = log.read_text()
    assert told.startswith("ended with this run: 1 process that it had started: ") and f"({child()})" in told


def test_a_daemon_lives_on_and_holds_nothing(tmp_path, child):
    began = time.monotonic()
    outcomes = run_local(
        [Job("box", "daemon-talks", seed) for seed in range(2)],
        tmp_path, Recorder(), Limits(1), command=("-c", FORKS),
    )  # fmt: skip
    assert all(outcome.finished for outcome in outcomes) and time.monotonic() - began < 20
    assert lives(child())


def test_the_time_limit_holds_where_a_child_keeps_the_pipe_open(tmp_path, child, monkeypatch):
    monkeypatch.setattr(process, "GRACE_SECONDS", 0.3)
    began = time.monotonic()
    (outcome,) = run_local(
        [Job("box", "hangs", 0)], tmp_path, Recorder(), Limits(timeout_min=1 / 60, retries=0), command=("-c", FORKS)
    )
    assert outcome.error == f"stopped after {1 / 60:g} min (--timeout-min)" and time.monotonic() - began < 20
    assert not lives(child())


REAL = """
import os, sys, threading, time
from activestructure_gym.evaluation.running import worker
worker._PATIENCE_SECONDS = 0.2
"""


def test_a_thread_that_never_ends_does_not_keep_the_worker_alive():
    code = f"{REAL}threading.Thread(target=time.sleep, args=(60,), name='wild').start()\nworker.end_after(lambda: 3)"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30)
    assert ended.returncode == 3
    assert ended.stderr == "this process is ended 0.2 s after its run, since threads of it have not ended: wild\n"


def test_neither_forks_nor_programs_of_a_policy_hold_the_worker_s_descriptors(tmp_path):
    # The pipe's other end is read to its end, although a fork and a program of the worker live.
    code = f"""{REAL}
import subprocess
channel, lock = map(int, sys.argv[1:])
worker._keep_from_children([channel, lock])
programs = [subprocess.Popen(["sleep", "60"], close_fds=False)]
child = os.fork()
if child == 0:
    os.write(channel, b"of the child")
    time.sleep(60)
os.write(channel, f"{{child}} {{programs[0].pid}}".encode())
"""
    ends = [os.pipe(), os.pipe()]
    own = subprocess.Popen([sys.executable, "-c", code, str(ends[0][1]), str(ends[1][1])],
                           pass_fds=[ends[0][1], ends[1][1]])  # fmt: skip
    for _, written in ends:
        os.close(written)
    assert own.wait(30) == 0
    said = os.read(ends[0][0], 1000)
    left = [int(number) for number in said.split()]
    try:
        assert all(map(lives, left))
        assert os.read(ends[0][0], 1000) == b"" and os.read(ends[1][0], 1000) == b""
    finally:
        for number in left:
            os.kill(number, signal.SIGKILL)
        for read, _ in ends:
            os.close(read)


FAULT = """Fatal Python error: Segmentation fault

Thread 0x00007f (most recent call first):
  File "/usr/lib/threading.py", line 1 in wait

Current thread 0x00007e (most recent call first):
  File "/home/me/bad.py", line 12 in act
  File "/x/episode.py", line 90 in run_job

Extension modules: numpy._core (total: 1)
"""


@pytest.mark.parametrize(("code", "said", "words"), [
    (0, "", "the policy ended the process (exit code 0) before the run was done"),
    (0, "step 12\n", "the policy ended the process (exit code 0) before the run was done"),
    (3, "Traceback\nSystemExit: 3\n", "the policy ended the process (exit code 3) before the run was done"),
    (3, "", "the worker wrote nothing (exit code 3)"),
    (1, "Traceback\nValueError: x\n", "ValueError: x (exit code 1)"),
    (-9, "", "the worker wrote nothing (killed by signal 9, SIGKILL: perhaps because memory ran out)"),
    (-11, FAULT, "Segmentation fault in act, /home/me/bad.py:12 (killed by signal 11, SIGSEGV: a fault in compiled "
                 "code, or too little memory or address space (ulimit -v))"),
    (-6, "terminate called\n", "terminate called (killed by signal 6, SIGABRT: a fault in compiled code, or too "
                               "little memory or address space (ulimit -v))"),
    (-signal.SIGUSR1, "x", f"x (killed by signal {signal.SIGUSR1:d}, SIGUSR1)"),
    (-63, "x", "x (killed by signal 63)"),
    (1, "MemoryError\n", "MemoryError (memory ran out: use fewer --workers or a smaller scene) (exit code 1)"),
    (1, "numpy._core._exceptions._ArrayMemoryError: Unable to allocate 9 TiB",
     "numpy._core._exceptions._ArrayMemoryError: Unable to allocate 9 TiB (memory ran out: use fewer --workers or a "
     "smaller scene) (exit code 1)"),
])  # fmt: skip
def test_the_words_about_a_worker_that_left_no_result(tmp_path, code, said, words):
    (tmp_path / "log").write_text("of the first attempt\n" + said)
    assert failure_text(tmp_path / "log", len("of the first attempt\n"), code) == words


def test_the_words_about_an_exception_in_this_process():
    assert error_text(KeyError("x")) == "KeyError: 'x'"
    assert error_text(SystemExit()) == "the policy ended the process (exit code 0) before the run was done"
    assert error_text(MemoryError()) == "MemoryError (memory ran out: use fewer --workers or a smaller scene)"


def lives(number: int) -> bool:
    """Whether a process runs, and does not only wait to be forgotten."""
    if not is_alive(number):
        return False
    try:
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False
