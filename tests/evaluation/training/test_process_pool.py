"""Calls in processes of their own, and what ends them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from activestructure_gym.evaluation.training.process_pool import spread

_MOST_S = 45  # seconds to wait on a busy machine; less than the 60 s of a call, which must not play to its end

# Calls that are long, or fail; `spread` never returns before the workers have ended.
PROGRAM = """
    import os, signal, sys, time
    from pathlib import Path
    from activestructure_gym.evaluation.training.process_pool import spread

    def work(place, seconds):
        (Path(place) / f"begun-{time.monotonic_ns()}").touch()
        if seconds == -2:
            os.kill(os.getpid(), 9)
        if seconds < 0:
            raise ValueError("broken")
        time.sleep(seconds)

    if __name__ == "__main__":
        signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs inherit that it is ignored
        for _ in spread(work, [(sys.argv[1], float(seconds)) for seconds in sys.argv[2:]], 2):
            pass
"""


def begun(place: Path, *seconds: float) -> subprocess.Popen[bytes]:
    """The program, as a process group of its own, once its first calls have begun."""
    program = place / "program.py"
    program.write_text(textwrap.dedent(PROGRAM))
    words = [sys.executable, str(program), str(place), *map(str, seconds)]
    process = subprocess.Popen(words, start_new_session=True, stderr=subprocess.PIPE)
    while process.poll() is None and not any(place.glob("begun-*")):
        time.sleep(0.01)
    return process


def test_ctrl_c_plays_no_call_to_its_end(tmp_path: Path) -> None:
    process = begun(tmp_path, *[60.0] * 4)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does, to all of them
    _, said = process.communicate(timeout=_MOST_S)
    assert process.returncode != 0 and said.count(b"KeyboardInterrupt") == 1  # of this process alone
    assert len(list(tmp_path.glob("begun-*"))) <= 2


def test_an_error_is_raised_while_others_are_at_work(tmp_path: Path) -> None:
    process = begun(tmp_path, -1.0, *[60.0] * 3)
    _, said = process.communicate(timeout=_MOST_S)
    assert process.returncode == 1 and b"ValueError: broken" in said


def test_a_killed_worker_is_one_sentence(tmp_path: Path) -> None:
    process = begun(tmp_path, -2.0, *[60.0] * 3)
    _, said = process.communicate(timeout=_MOST_S)
    assert b"InputError: a worker process was killed, perhaps because memory ran out: use fewer --workers" in said


@pytest.mark.parametrize("workers", [1, 2])
def test_all_calls_are_made_and_counted(workers: int) -> None:
    assert list(spread(abs, [(-1,), (-2,), (-3,)][:workers], workers)) == [1, 2, 3][:workers]
