"""What is said while kernels are compiled: on a terminal, in a log, and by which of several processes."""

from __future__ import annotations

import io
import os
import sys
import time

import pytest
from numba.core import event

from activestructure_gym.compiling import ahead, kernel, progress
from activestructure_gym.compiling.locks import LOCKS


def test_the_lines() -> None:
    assert progress.describe(7, 12.3) == "compiling kernels, once per installation: 7 so far, 12 s"
    assert progress.begin() == "compiling kernels, once per installation: about a minute on two cores"
    assert progress.describe(7, 12.3, 47) == "compiling kernels, once per installation: 7 of 47, 12 s"
    assert progress.conclusion(1, 0.4) == "compiled 1 kernel in 0 s"
    assert progress.conclusion(54, 30) == "compiled 54 kernels in 30 s"


def test_a_log_gets_a_first_and_a_last_line_and_none_when_all_is_compiled(package, run, tmp_path) -> None:
    code = "import numpy, tiny; tiny.total(numpy.ones(3)); print(tiny.doubled(2))"
    out, err = run(package, code, cache=tmp_path / "cache")
    first, last = err.splitlines()
    assert out == "4" and first == progress.begin()
    assert last.startswith("compiled 2 kernels in ") and last.endswith(" s")
    assert run(package, code, cache=tmp_path / "cache") == ("4", "")


def test_a_log_hears_now_and_then_and_of_the_end(monkeypatch) -> None:
    monkeypatch.setattr(progress, "_QUIET", 0.2)
    monkeypatch.setattr(progress, "_EVERY", 0.05)
    log, stream = progress.Log(), io.StringIO()
    for compiled in (1, 2, 3):
        log.hear(compiled, 10.0 * compiled, stream)
        time.sleep(0.1)
    waited = time.monotonic()
    while "compiled 3" not in stream.getvalue() and time.monotonic() - waited < 10:
        time.sleep(0.01)
    lines = stream.getvalue().splitlines()
    assert lines[0] == progress.begin() and lines[-1] == "compiled 3 kernels in 30 s"
    assert len(lines) > 2 and set(lines[1:-1]) <= {progress.describe(n, 10 * n) for n in (1, 2, 3)}
    log.conclude()  # said already
    log.hear(4, 40.0, stream)  # after a pause there is one more
    log.conclude()
    assert stream.getvalue().splitlines()[len(lines) :] == ["compiled 4 kernels in 40 s"]


def test_a_log_ends_where_it_began() -> None:
    log, first, second = progress.Log(), io.StringIO(), io.StringIO()
    log.hear(1, 1.0, first)
    log.hear(2, 2.0, second)  # somebody captures what his own call says
    log.conclude()
    assert first.getvalue().splitlines() == [progress.begin(), "compiled 2 kernels in 2 s"]
    assert second.getvalue() == ""
    log.hear(3, 3.0, second)
    second.close()  # and is done before the end
    log.conclude()


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="no terminals here")
def test_a_terminal_gets_a_line_that_counts_and_goes_away(package, run, tmp_path) -> None:
    ours, theirs = os.openpty()
    code = "import numpy, tiny; print(tiny.total(numpy.ones(3)), tiny.doubled(2))"
    out, _ = run(package, code, cache=tmp_path / "cache", stderr=theirs)
    os.close(theirs)
    shown = os.read(ours, 10_000).decode()
    os.close(ours)
    assert out == "6.0 4" and "\n" not in shown
    lines = [line for line in shown.split("\r") if line.strip()]
    assert lines[0].startswith("compiling kernels, once per installation: 1 so far, ")
    assert lines[-1].startswith("compiling kernels, once per installation: 2 so far, ")
    # Blanks over the last line, and the cursor at its beginning.
    assert shown.endswith("\r" + " " * len(lines[-1]) + "\r")


class Terminal(io.StringIO):
    """Says that it is one."""

    def isatty(self) -> bool:
        return True


def test_beside_a_spinner_the_lines_are_those_of_a_log(kept, monkeypatch) -> None:
    # rich puts an object of its own in the place of sys.stderr while a spinner turns.
    monkeypatch.setattr(LOCKS, "take", lambda name: True)  # another process may be the one that tells
    monkeypatch.setattr(LOCKS, "drop", lambda name: None)
    monkeypatch.setattr(ahead, "_started", [True])
    monkeypatch.setattr("activestructure_gym.compiling.decorator.PROGRESS", mine := progress.Progress())
    monkeypatch.setattr(sys, "stderr", Terminal())

    @kernel
    def halved(x):
        return x / 2

    event.register("numba:compile", mine)
    try:
        assert halved(3) == 1.5
        assert halved(3.0) == 1.5
    finally:
        event.unregister("numba:compile", mine)
    mine._log.conclude()
    first, last = sys.stderr.getvalue().splitlines()
    assert first == progress.begin() and last.startswith("compiled 1 kernel in ")
