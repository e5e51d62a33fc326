"""Of processes that start together one compiles and the others load, however one of them ends."""

from __future__ import annotations

import signal

import pytest

from activestructure_gym.compiling import locks, progress

# Compiles both, and says what it compiled and what came out.
USE = """
import sys, numpy
from activestructure_gym.compiling import told_to
import tiny
compiled = []
sys.stdin.readline()
with told_to(compiled.append):
    result = tiny.total(numpy.arange(4.0)), tiny.doubled(21.0)
print(*result, *compiled)
"""

RESULT = "12.0 42.0"
BOTH = "tiny.total tiny.doubled"


@pytest.mark.slow
def test_processes_that_start_together_compile_everything_once(package, start, run, tmp_path) -> None:
    processes = [start(package, USE, cache=tmp_path / "cache") for _ in range(3)]
    for process in processes:
        process.stdin.write("go\n")
        process.stdin.flush()
    written = [process.communicate(timeout=120) for process in processes]
    assert [process.returncode for process in processes] == [0, 0, 0], written
    assert all(out.startswith(RESULT) for out, _ in written)
    compiled = [name for out, _ in written for name in out.removeprefix(RESULT).split()]
    assert sorted(compiled) == sorted(BOTH.split())
    assert run(package, USE, cache=tmp_path / "cache")[0] == RESULT


HOLD = """
import sys
from activestructure_gym.compiling.locks import LOCKS
assert LOCKS.take("tiny.total") and LOCKS.usable
print("held", flush=True)
sys.stdin.readline()
"""


@pytest.fixture
def holder(package, start, tmp_path):
    """A process that holds the lock of a kernel."""
    process = start(package, HOLD, cache=tmp_path / "cache")
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


@pytest.mark.skipif(locks.fcntl is None, reason="no locks between processes here")
def test_a_process_that_waits_for_a_killed_one_reports_and_goes_on(package, start, tmp_path, holder) -> None:
    code = """
        import numpy, tiny
        from activestructure_gym.compiling import locks
        locks._LOADING_S = 0.1
        print(tiny.total(numpy.ones(3)))
    """
    waiting = start(package, code, cache=tmp_path / "cache")
    assert waiting.stderr.readline() == f"{progress.describe(0, 0.0)}\n"
    assert waiting.poll() is None
    holder.send_signal(signal.SIGKILL)  # a killed process keeps no lock
    out, err = waiting.communicate(timeout=120)
    assert (out, waiting.returncode) == ("6.0\n", 0)
    assert err.splitlines()[-1].startswith("compiled 2 kernels in ")


@pytest.mark.skipif(locks.fcntl is None, reason="no locks between processes here")
def test_a_stopped_process_is_not_waited_for_without_end(package, run, tmp_path, holder) -> None:
    code = """
        import numpy, tiny
        from activestructure_gym.compiling import locks
        locks._PATIENCE_S = 0.2
        print(tiny.total(numpy.ones(3)))
    """
    holder.send_signal(signal.SIGSTOP)
    out, err = run(package, code, cache=tmp_path / "cache")
    assert out == "6.0"
    assert err.count("another process has held the kernel tiny.total for 0 s: it is compiled here too") == 1
