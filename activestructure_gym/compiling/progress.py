"""Report the compilation of kernels on standard error. Nothing is written while kernels are only loaded.

The report has one line at the beginning, one every 15 seconds, and one with the total time at the end. If several
processes compile at the same time, only the first one reports.
"""

from __future__ import annotations

import atexit
import multiprocessing
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import event

from activestructure_gym.compiling import files
from activestructure_gym.compiling.locks import LOCKS
from activestructure_gym.streams import write_line

_EVERY_S = 15.0  # seconds between two lines
_QUIET_S = 10.0  # seconds without compilation after which the report ends
_OURS = __name__.partition(".")[0]


@contextmanager
def told_to(listener: Callable[[str], None]) -> Iterator[None]:
    """Call ``listener`` with the name of every kernel that this process compiles inside the ``with`` block.

    Inside the block, compilation is not reported on standard error, and no helper processes are started.
    """
    before, PROGRESS.listener = PROGRESS.listener, listener
    try:
        yield
    finally:
        PROGRESS.listener = before


def describe(compiled: int, seconds: float, total: int | None = None) -> str:
    """Return a line of the report: number of compiled kernels, of how many if ``total`` is given, and seconds."""
    often = "in every process" if files.not_kept else "once per installation, about a minute on two cores"
    return f"compiling kernels: {compiled} {'so far' if total is None else f'of {total}'}, {seconds:.0f} s ({often})"


def conclusion(compiled: int, seconds: float) -> str:
    """Return the last line of the report: number of compiled kernels and seconds."""
    return f"compiled {compiled} kernel{'' if compiled == 1 else 's'} in {seconds:.0f} s"


class Progress(event.Listener):
    """Report the kernels that numba compiles.

    Numba sends an event per compiled function and none for loading from disk.
    """

    def __init__(self) -> None:
        self.listener: Callable[[str], None] | None = None
        self.call_for_help: Callable[[], None] = lambda: None  # called when a kernel of this package is compiled
        # Name of the kernel being compiled; the functions that it calls cause events too.
        self._current: str | None = None
        self._compiled: set[str] = set()
        # Time spent on compilation so far in seconds, and time.monotonic() of the last compiled kernel.
        self._seconds, self._last = 0.0, 0.0
        self._stream: Any = None  # kept for all lines, because sys.stderr may be replaced later
        self._open = False  # whether the report has begun and not ended
        self._silent = False  # whether another process reports
        self._lock = threading.Lock()

    @contextmanager
    def around(self, name: str) -> Iterator[None]:
        """Set the name of the kernel that is compiled or loaded during the block; blocks may be nested."""
        outer, self._current, began = self._current, name, time.monotonic()
        try:
            yield
        finally:
            self._current = outer
            if outer is None:
                self._seconds += time.monotonic() - began

    def on_start(self, begun: event.Event) -> None:
        """Handle numba's event that compilation of a kernel, or of a function that it calls, starts."""
        if self._current is None:  # a function of another package
            return
        if self.listener is None:
            if self._current.startswith(_OURS + "."):
                self.call_for_help()
        elif self._current not in self._compiled:
            self.listener(self._current)
        self.report()

    def on_end(self, ended: event.Event) -> None:
        """Do nothing. The event at the start of a compilation is sufficient."""

    def report(self) -> None:
        """Count the current kernel as compiled, by this process or by another one for which this process waits.

        The first call starts the report.
        """
        assert self._current is not None
        self._compiled.add(self._current)
        self._last = time.monotonic()
        with self._lock:
            if self._open or self._silent or self.listener is not None or sys.stderr is None:
                return
            self._open = LOCKS.take("teller") and (LOCKS.usable or multiprocessing.parent_process() is None)
            self._silent = not self._open
            if self._silent:
                return
            if self._stream is None:
                self._stream = sys.stderr
                write_line(self._stream, describe(0, 0.0))
                atexit.register(self.conclude)
        threading.Thread(target=self._go_on, daemon=True, name="progress of compiling").start()

    def _go_on(self) -> None:
        written = time.monotonic()
        while self._open:
            time.sleep(_QUIET_S / 20)
            now = time.monotonic()
            if now - self._last > _QUIET_S and self._current is None:
                self.conclude()
            elif now - written > _EVERY_S:
                written = now
                write_line(self._stream, describe(len(self._compiled), self._seconds))

    def conclude(self) -> None:
        """Write the last line of the report, unless it has been written."""
        with self._lock:
            if self._open:
                self._open = False
                write_line(self._stream, conclusion(len(self._compiled), self._seconds))
                LOCKS.drop("teller")


PROGRESS = Progress()
event.register("numba:compile", PROGRESS)
