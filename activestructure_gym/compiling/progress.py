"""Progress of compiling on standard error: lines while kernels are compiled, and nothing otherwise.

A terminal gets one line that counts and goes away. A log gets a line at the beginning, one every half minute, and one
at the end. Of several processes that compile together only the first one speaks.
"""

from __future__ import annotations

import atexit
import multiprocessing
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TextIO

from numba.core import event

from activestructure_gym.compiling import files
from activestructure_gym.compiling.locks import LOCKS
from activestructure_gym.streams import lowest, raw

_EVERY = 30.0  # seconds between two lines in a log
_QUIET = 10.0  # seconds without compiling, after which it counts as done
_OURS = __name__.partition(".")[0]


@contextmanager
def told_to(listener: Callable[[str], None]) -> Iterator[None]:
    """Call ``listener`` with the name of every kernel this process begins to compile.

    Nothing is written, and no second process is started: whoever listens has arranged how the work is shared.
    """
    before, PROGRESS.listener = PROGRESS.listener, listener
    try:
        yield
    finally:
        PROGRESS.listener = before


def describe(compiled: int, seconds: float, total: int | None = None) -> str:
    """Return the progress line: kernels compiled so far, of how many where that is known, and seconds."""
    return f"{_heading()}: {compiled} {'so far' if total is None else f'of {total}'}, {seconds:.0f} s"


def begin() -> str:
    """Return the first line of a log."""
    return f"{_heading()}: about a minute on two cores"


def conclusion(compiled: int, seconds: float) -> str:
    """The last line of a log."""
    return f"compiled {compiled} kernel{'' if compiled == 1 else 's'} in {seconds:.0f} s"


def _heading() -> str:
    return f"compiling kernels, once per {'process' if files.not_kept else 'installation'}"


def _standard_error() -> TextIO | None:
    stream: TextIO | None = raw(sys.stderr)  # None in a program without a console
    return stream


class Log:
    """The lines of a log: when work begins, every half minute of it, and when none has come for a while.

    All of them go where the first went: what stands in the place of standard error by then belongs to somebody else.
    """

    def __init__(self) -> None:
        self._stream: TextIO | None = None
        self._lock = threading.Lock()
        self._compiled, self._seconds = 0, 0.0  # so far
        self._said = 0  # kernels, in the last line
        self._last = 0.0  # when something was heard
        self._open = False  # the end has not been told yet

    def hear(self, compiled: int, seconds: float, stream: TextIO) -> None:
        """Note how many kernels have been compiled and in how many seconds; a line is written where one is due."""
        with self._lock:
            self._compiled, self._seconds, self._last = compiled, seconds, time.monotonic()
            if self._open:
                return
            self._open, self._stream = True, stream
            if self._said == 0:
                self._write(begin())
                atexit.register(self.conclude)
        threading.Thread(target=self._go_on, daemon=True, name="progress of compiling").start()

    def conclude(self) -> None:
        """Write the last line of the log, unless nothing was compiled since the last one."""
        with self._lock:
            if self._open:
                self._open, self._said = False, self._compiled
                self._write(conclusion(self._compiled, self._seconds))

    def _write(self, line: str) -> None:
        if self._stream is not None:
            with suppress(OSError, ValueError):  # closed: the program, or what has captured its output, has ended
                self._stream.write(line + "\n")
                self._stream.flush()

    def _go_on(self) -> None:
        spoken = time.monotonic()
        while self._open:
            time.sleep(_QUIET / 20)
            now = time.monotonic()
            if now - self._last > _QUIET:
                self.conclude()
            elif now - spoken > _EVERY:
                spoken = now
                self._write(describe(self._compiled, self._seconds))


class Progress(event.Listener):
    """Reports what numba compiles, by its compile events; loading a kernel from disk causes none."""

    def __init__(self) -> None:
        self.listener: Callable[[str], None] | None = None
        self.call_for_help: Callable[[], None] = lambda: None  # when a kernel of this package is compiled
        self._current: str | None = None  # the kernel in work; functions it calls have events, too
        self._marked: set[str] = set()  # kernels of which other processes know that they are compiled here
        self._told: set[str] = set()  # kernels that had to be compiled
        self._spent, self._began = 0.0, 0.0
        self._speaks = False  # holds the lock that goes with the line
        self._silent = False  # for good: another process speaks
        self._width = 0  # of the line that stands on the terminal
        self._log = Log()

    @contextmanager
    def around(self, name: str) -> Iterator[None]:
        """Context: one kernel is being compiled or loaded; may be nested."""
        outer, self._current = self._current, name
        if outer is None:
            self._began = time.monotonic()
        try:
            yield
        finally:
            self._current = outer
            if name in self._marked:
                self._marked.remove(name)
                LOCKS.drop(_mark(name))
            if outer is None:
                self._spent += time.monotonic() - self._began
                self._end()

    def on_start(self, begun: event.Event) -> None:
        """numba begins to compile a kernel, or a function it calls."""
        if self._current is None:  # not ours
            return
        if self._current not in self._marked:
            self._marked.add(self._current)
            LOCKS.take(_mark(self._current))
        if self.listener is None:
            if self._current.startswith(_OURS + "."):
                self.call_for_help()
        elif self._current not in self._told:
            self.listener(self._current)
        self._tell()

    def on_end(self, ended: event.Event) -> None:
        """Does nothing: the next start event, or the end of ``around``, reports the progress."""

    def waiting(self) -> None:
        """Report the kernel that another process holds, if that process compiles it and does not only load it."""
        assert self._current is not None
        if LOCKS.is_held(_mark(self._current)):
            self._tell()

    def _tell(self) -> None:
        """Report that the current kernel is being compiled, here or by the process this one waits for."""
        assert self._current is not None
        self._told.add(self._current)
        stream = _standard_error()
        if self.listener is not None or self._silent or stream is None:
            return
        if not self._speaks:
            self._speaks = LOCKS.take("teller") and (LOCKS.usable or multiprocessing.parent_process() is None)
            self._silent = not self._speaks
        if self._silent:
            return
        seconds = self._spent + time.monotonic() - self._began
        # A live line only where nothing else writes: a spinner puts itself in the place of sys.stderr.
        live = lowest(stream) is sys.__stderr__
        if live and stream.isatty():
            line = describe(len(self._told), seconds)[: shutil.get_terminal_size().columns - 1]
            stream.write("\r" + line.ljust(self._width))
            stream.flush()
            self._width = len(line)
        else:
            self._log.hear(len(self._told), seconds, stream)

    def _end(self) -> None:
        stream = _standard_error()
        if self._width and stream is not None:
            stream.write("\r" + " " * self._width + "\r")
            stream.flush()
        self._width = 0
        if self._speaks:
            self._speaks = False
            LOCKS.drop("teller")


def _mark(name: str) -> str:
    """Name of the lock that a process holds while it compiles a kernel, but not while it loads one."""
    return f"compiling {name}"


PROGRESS = Progress()
event.register("numba:compile", PROGRESS)
