"""Standard error shows when compiling begins, how far it is, and how long it took; nothing when all is compiled."""

from __future__ import annotations

import io
import sys
import time

import pytest

from activestructure_gym.compiling import progress
from activestructure_gym.compiling.locks import Locks
from activestructure_gym.compiling.progress import Progress


def test_the_lines() -> None:
    often = "(once per installation, about a minute on two cores)"
    assert progress.describe(7, 12.3) == f"compiling kernels: 7 so far, 12 s {often}"
    assert progress.describe(7, 12.3, 47) == f"compiling kernels: 7 of 47, 12 s {often}"
    assert progress.conclusion(1, 0.4) == "compiled 1 kernel in 0 s"
    assert progress.conclusion(54, 30) == "compiled 54 kernels in 30 s"


def test_a_process_reports_its_compiling_and_none_when_all_is_compiled(package, run, tmp_path) -> None:
    code = "import numpy, tiny; tiny.total(numpy.ones(3)); print(tiny.doubled(2))"
    out, err = run(package, code, cache=tmp_path / "cache")
    first, last = err.splitlines()
    assert out == "4" and first == progress.describe(0, 0.0)
    assert last.startswith("compiled 2 kernels in ") and last.endswith(" s")
    assert run(package, code, cache=tmp_path / "cache") == ("4", "")


@pytest.fixture
def reporting(kept, monkeypatch) -> Progress:
    """Progress of its own, which is quick to report."""
    monkeypatch.setattr(progress, "LOCKS", Locks())
    monkeypatch.setattr(progress, "_QUIET_S", 0.2)
    monkeypatch.setattr(progress, "_EVERY_S", 0.05)
    return Progress()


def lines_of(stream: io.StringIO, last: str) -> list[str]:
    waited = time.monotonic()
    while last not in stream.getvalue() and time.monotonic() - waited < 10:
        time.sleep(0.01)
    return stream.getvalue().splitlines()


def test_lines_come_now_and_then_and_at_the_end(reporting, monkeypatch) -> None:
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    for number in (1, 2, 3):
        with reporting.around(f"kernel {number}"):
            reporting.report()
            time.sleep(0.1)
    lines = lines_of(sys.stderr, "compiled 3 kernels in 0 s")
    assert lines[0] == progress.describe(0, 0.0) and lines[-1] == "compiled 3 kernels in 0 s"
    assert len(lines) > 2 and set(lines[1:-1]) <= {progress.describe(number, 0) for number in (1, 2, 3)}
    reporting.conclude()  # nothing is left to say
    with reporting.around("kernel 4"):  # after a pause
        reporting.report()
    assert lines_of(sys.stderr, "compiled 4 kernels")[-1] == "compiled 4 kernels in 0 s"
    assert sys.stderr.getvalue().count(progress.describe(0, 0.0)) == 1


def test_all_lines_go_to_the_first_stream_even_if_it_is_closed(reporting, monkeypatch) -> None:
    first, second = io.StringIO(), io.StringIO()
    monkeypatch.setattr(sys, "stderr", first)
    with reporting.around("kernel"):
        reporting.report()
        monkeypatch.setattr(sys, "stderr", second)
        first.close()
    reporting.conclude()
    assert second.getvalue() == ""


def test_of_two_processes_one_reports(reporting, monkeypatch) -> None:
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    monkeypatch.setattr(progress.LOCKS, "take", lambda name: False)
    with reporting.around("kernel"):
        reporting.report()
    reporting.conclude()
    assert sys.stderr.getvalue() == ""
