"""Report compiling on standard error; nothing is written while kernels are only loaded.

There is one line at the beginning, one every quarter of a minute, and one with the time at the end. Of several
processes that compile together only the first reports.
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

_EVERY_S = 15.0  # between two lines
_QUIET_S = 10.0  # without compiling, after which it counts as finished
_OURS = __name__.partition(".")[0]


@contextmanager
def told_to(listener: Callable[[str], None]) -> Iterator[None]:
    """Call ``listener`` with the name of every kernel that this process compiles inside the block.

    This replaces the progress report: the block writes nothing to standard error. It also starts no helper processes
    for compiling.
    """
    before, PROGRESS.listener = PROGRESS.listener, listener
    try:
        yield
    finally:
        PROGRESS.listener = before


def describe(compiled: int, seconds: float, total: int | None = None) -> str:
    """Return the line of progress: kernels compiled, their total where it is known, and seconds."""
    often = "in every process" if files.not_kept else "once per installation, about a minute on two cores"
    return f"compiling kernels: {compiled} {'so far' if total is None else f'of {total}'}, {seconds:.0f} s ({often})"


def conclusion(compiled: int, seconds: float) -> str:
    """Return the last line."""
    return f"compiled {compiled} kernel{'' if compiled == 1 else 's'} in {seconds:.0f} s"


class Progress(event.Listener):
    """Report kernels that numba compiles, by its events; loading a kernel from disk causes none."""

    def __init__(self) -> None:
        self.listener: Callable[[str], None] | None = None
        self.call_for_help: Callable[[], None] = lambda: None  # called when a kernel of this package is compiled
        self._current: str | None = None  # the kernel in work; functions that it calls cause events too
        self._compiled: set[str] = set()
        self._seconds, self._last = 0.0, 0.0  # spent so far, and when the last kernel was reported
        self._stream: Any = None  # all lines go to the first stream: standard error may be replaced later
        self._open = False  # the last line is still to come
        self._silent = False  # another process reports
        self._lock = threading.Lock()

    @contextmanager
    def around(self, name: str) -> Iterator[None]:
        """Set the kernel that is compiled or loaded while the block runs; may be nested."""
        outer, self._current, began = self._current, name, time.monotonic()
        try:
            yield
        finally:
            self._current = outer
            if outer is None:
                self._seconds += time.monotonic() - began

    def on_start(self, begun: event.Event) -> None:
        """Report that numba compiles a kernel, or a function that it calls."""
        if self._current is None:  # a function of another package
            return
        if self.listener is None:
            if self._current.startswith(_OURS + "."):
                self.call_for_help()
        elif self._current not in self._compiled:
            self.listener(self._current)
        self.report()

    def on_end(self, ended: event.Event) -> None:
        """Do nothing: one event of a function is enough."""

    def report(self) -> None:
        """Report that the current kernel is compiled, here or by the process that this one waits for."""
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
        """Write the last line, unless it was written."""
        with self._lock:
            if self._open:
                self._open = False
                write_line(self._stream, conclusion(len(self._compiled), self._seconds))
                LOCKS.drop("teller")


PROGRESS = Progress()
event.register("numba:compile", PROGRESS)
