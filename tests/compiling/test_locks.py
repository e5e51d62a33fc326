"""Of processes that start together one compiles and the others load, however one of them ends."""

from __future__ import annotations

import select
import signal
import sys

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
if "compiling" in sys.argv:
    assert LOCKS.take("compiling tiny.total")
print("held", flush=True)
sys.stdin.readline()
"""


@pytest.mark.skipif(locks.fcntl is None, reason="no locks between processes here")
@pytest.mark.parametrize("at", ["compiling", "loading"])
def test_who_waits_speaks_of_compiling_only_if_something_is_compiled(package, start, tmp_path, at) -> None:
    use = "import numpy, tiny; print(tiny.total(numpy.ones(3)))"
    holder = start(package, HOLD, at, cache=tmp_path / "cache")
    assert holder.stdout.readline() == "held\n"
    waiting = start(package, "print('up', flush=True);" + use, cache=tmp_path / "cache")
    assert waiting.stdout.readline() == "up\n"
    if at == "compiling":
        assert waiting.stderr.readline() == f"{progress.begin()}\n"
    else:
        assert not select.select([waiting.stderr], [], [], 2.0)[0]
    assert waiting.poll() is None
    holder.send_signal(signal.SIGKILL)  # a killed process keeps no lock
    out, err = waiting.communicate(timeout=120)
    holder.communicate()
    assert (out, waiting.returncode) == ("6.0\n", 0)
    assert err.splitlines()[-1].startswith("compiled ")


@pytest.mark.skipif(locks.fcntl is None, reason="no locks between processes here")
def test_nobody_waits_for_a_stopped_process_for_ever(package, start, run, tmp_path) -> None:
    holder = start(package, HOLD, cache=tmp_path / "cache")
    assert holder.stdout.readline() == "held\n"
    code = """
        import numpy, tiny
        from activestructure_gym.compiling import locks, progress
        locks._PATIENCE, locks._SILENCE = 0.4, 0.1
        print(tiny.total(numpy.ones(3)))
    """
    holder.send_signal(signal.SIGSTOP)
    out, err = run(package, code, cache=tmp_path / "cache")
    holder.send_signal(signal.SIGCONT)
    holder.communicate("end\n")
    assert out == "6.0"
    said = "waiting up to 0 s for another process, which loads or compiles tiny.total"
    if sys.platform == "linux":
        said = said.replace("another process", f"process {holder.pid}, which is stopped")
    assert err.count(said) == 1
