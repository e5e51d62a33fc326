"""The decorator of all kernels: compiled once per installation, by one process at a time, and not in silence.

numba compiles a function when it is first called and keeps the machine code: beside the source, or in the user's cache
directory where the package cannot be written, or where ``NUMBA_CACHE_DIR`` says. Two things are added here; both come
into play only where a kernel is not in memory yet.

Processes that start together (the workers of a vector environment, the two halves of a warm-up) lock each kernel while
they compile or load it: one compiles, the others load what it wrote. The locks are ranges of one file beside the cache
and end with their process, however it ends.

While something is compiled, one line on standard error says so; of several processes only the first one tells.

With the first of our kernels that has to be compiled, a second process begins with those that will be needed last
(`compile_ahead`), where there is a second core and what it compiles can be kept.
"""

from __future__ import annotations

import atexit
import gc
import multiprocessing
import os
import shutil
import subprocess
import sys
import time
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TextIO

from numba import njit
from numba.core import event
from numba.core.compiler_lock import global_compiler_lock

try:
    import fcntl
except ImportError:  # Windows: every process compiles for itself
    fcntl = None  # type: ignore[assignment]

EPISODE_KERNELS = 54  # that an episode uses, about: gains and scene decide about a few
_PATIENCE = 120.0  # seconds, for one kernel of another process: many times the slowest
_UNREMARKED = 0.5  # seconds of waiting: another process may only be loading


def kernel(function: Callable[..., Any]) -> Any:
    """Compile for use from Python: cached on disk, without the GIL, dividing by zero as numpy does.

    Where no cache can be written, the kernel is compiled by every process, and one warning names the remedy.
    """
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    dispatcher: Any
    try:
        dispatcher = njit(cache=True, **options)(function)
    except RuntimeError:  # numba found no writable place for its cache
        _warn_of_no_cache("no directory for them can be written")
        dispatcher = njit(**options)(function)
    if not hasattr(dispatcher, "compile"):  # NUMBA_DISABLE_JIT
        return dispatcher
    name = _name_of(function)
    compile_or_load = dispatcher.compile

    def compile_or_load_alone(signature: Any) -> Any:
        # The lock between threads first, as numba itself nests it: otherwise two processes could each hold what a
        # thread of the other waits for.
        with global_compiler_lock, _VOICE.around(name), _LOCKS.held(name), _uncollected():
            try:
                return compile_or_load(signature)
            except OSError as error:  # disk full, or a quota
                _warn_of_no_cache(str(error))
                return compile_or_load(signature)  # in memory by then

    dispatcher.compile = compile_or_load_alone  # numba calls it for every signature it has no machine code for
    return dispatcher


def _name_of(function: Callable[..., Any]) -> str:
    return f"{function.__module__}.{function.__qualname__}"


@contextmanager
def told_to(listener: Callable[[str], None]) -> Iterator[None]:
    """Call ``listener`` with the name of every kernel this process begins to compile.

    Nothing is written, and no second process is started: whoever listens has arranged how the work is shared.
    """
    before, _VOICE.listener = _VOICE.listener, listener
    try:
        yield
    finally:
        _VOICE.listener = before


def describe(compiled: int, seconds: float) -> str:
    """How far it is, in one line."""
    how_far = f"{compiled} of about {EPISODE_KERNELS}" if compiled < EPISODE_KERNELS else str(compiled)
    return f"compiling kernels, once per {'process' if _WARNED else 'installation'}: {how_far}, {seconds:.0f} s"


_WARNED: list[str] = []  # why nothing is kept


def _warn_of_no_cache(reason: str) -> None:
    if not _WARNED and multiprocessing.parent_process() is None:
        warnings.warn(
            f"compiled kernels cannot be kept ({reason}), so every process compiles them again; "
            "set the environment variable NUMBA_CACHE_DIR to a directory that can be written",
            stacklevel=4,
        )
    _WARNED.append(reason)


def held_elsewhere(kernel: Any) -> bool:
    """Whether another process is just compiling or loading a kernel."""
    name = _name_of(kernel.py_func)
    free = _LOCKS.take(name)
    if free:
        _LOCKS.drop(name)
    return not free


@contextmanager
def only_helper() -> Iterator[bool]:
    """While the block runs, nobody else helps; gives False if somebody does already. Starts no helper either."""
    free = _LOCKS.take(_HELPER) and _LOCKS.usable
    try:
        with told_to(lambda name: None):
            yield free
    finally:
        if free:
            _LOCKS.drop(_HELPER)


_HELPER = "helper"  # the lock of `compile_ahead`
_HELPED: list[bool] = []  # a process looks for help once
# The helper finds this package, and everything else, where its parent does.
_START = (
    "import os, sys; sys.path[:] = sys.argv[1].split(os.pathsep);"
    "from activestructure_gym.compile_ahead import main; main(int(sys.argv[2]), sys.argv[3:])"
)


def _get_help() -> None:
    """Start `compile_ahead`, where that can help and nobody does already."""
    if _HELPED:
        return
    _HELPED.append(True)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    an_interpreter = Path(sys.executable or "").name.startswith("python") and not getattr(sys, "frozen", False)
    if cores < 2 or not an_interpreter or _WARNED or multiprocessing.parent_process() is not None:
        return
    if not _LOCKS.take(_HELPER) or not _LOCKS.usable:
        return
    _LOCKS.drop(_HELPER)
    package = __name__.partition(".")[0]
    # Who uses the rasteriser alone needs no more. An episode begins with the sensor and goes on for long with planes.
    of_episode = ["motion", "views", "score", "sensing"] if f"{package}.volume" in sys.modules else []
    with suppress(OSError):  # no more processes allowed
        helper = subprocess.Popen(
            [sys.executable, "-c", _START, os.pathsep.join(sys.path), str(os.getpid()), "rasteriser", *of_episode],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C reaches it through its parent's end
        )
        atexit.register(_dismiss, helper, os.getpid())


def _dismiss(helper: subprocess.Popen[bytes], parent: int) -> None:
    if os.getpid() == parent:  # not a fork of it
        helper.kill()
        helper.wait()


@contextmanager
def _uncollected() -> Iterator[None]:
    """Without looking for garbage: a compiler makes millions of objects and few cycles. A twentieth of its time."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


class _Locks:
    """Locks between processes, each by name; without effect where the system or the file system has none."""

    def __init__(self) -> None:
        self._file: int | None = None
        self.usable = fcntl is not None

    def take(self, name: str) -> bool:
        """Take the lock if it is free; False if another process holds it."""
        if not self.usable:
            return True
        try:
            if self._file is None:
                self._file = os.open(_lock_path(), os.O_RDWR | os.O_CREAT, 0o666)
            # Ranges may lie beyond the end of the file. Two names may share one: then one waits without need.
            fcntl.lockf(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, zlib.crc32(name.encode()))
        except BlockingIOError:
            return False
        except (OSError, RuntimeError):
            self.usable = False
        return True

    def drop(self, name: str) -> None:
        """Give the lock back."""
        if self.usable and self._file is not None:
            fcntl.lockf(self._file, fcntl.LOCK_UN, 1, zlib.crc32(name.encode()))

    @contextmanager
    def held(self, name: str) -> Iterator[None]:
        """Wait for the lock, and hold it while the block runs."""
        began = time.monotonic()
        while not self.take(name):
            waited = time.monotonic() - began
            if waited > _PATIENCE:  # its holder is stopped, or the file system keeps locks of the dead
                self.usable = False
                break
            if waited > _UNREMARKED:
                _VOICE.tell()
            time.sleep(0.02)
        try:
            yield
        finally:
            self.drop(name)


def cache_place() -> Path | None:
    """The directory of this room's compiled kernels, where numba puts it; None where they cannot be kept."""

    def probe() -> None: ...

    try:
        dispatcher: Any = njit(cache=True)(probe)
    except RuntimeError:
        return None
    return Path(dispatcher.stats.cache_path) if hasattr(dispatcher, "stats") else None  # NUMBA_DISABLE_JIT


def _lock_path() -> Path:
    """Beside the cache of this room; raises RuntimeError where there is none."""
    place = cache_place()
    if place is None:
        raise RuntimeError("no directory for compiled kernels")
    return place / "activestructure_gym-kernels.lock"


def _standard_error() -> TextIO | None:
    return sys.stderr  # None in a program without a console


class _Voice(event.Listener):
    """Tells what is compiled. numba's event comes with every compilation and with nothing that is loaded."""

    def __init__(self) -> None:
        self.listener: Callable[[str], None] | None = None
        self._current: str | None = None  # the kernel in work; functions it calls have events, too
        self._told: set[str] = set()  # kernels that had to be compiled
        self._spent, self._began = 0.0, 0.0
        self._teller = False  # holds the lock that goes with the line
        self._silent = False  # for good: another process tells
        self._width = 0  # of the line that stands on the terminal
        self._said = False  # the plain line

    @contextmanager
    def around(self, name: str) -> Iterator[None]:
        """While one kernel is compiled or loaded; may be nested."""
        outer, self._current = self._current, name
        if outer is None:
            self._began = time.monotonic()
        try:
            yield
        finally:
            self._current = outer
            if outer is None:
                self._spent += time.monotonic() - self._began
                self._end()

    def on_start(self, begun: event.Event) -> None:
        """numba begins to compile a kernel, or a function it calls."""
        if self._current is None:  # not ours
            return
        if self.listener is None:
            if self._current.startswith(__name__.partition(".")[0] + "."):
                _get_help()
        elif self._current not in self._told:
            self.listener(self._current)
        self.tell()

    def tell(self) -> None:
        """The kernel in work is compiled, here or by the process this one waits for."""
        assert self._current is not None
        self._told.add(self._current)
        self._write(describe(len(self._told), self._spent + time.monotonic() - self._began))

    def on_end(self, ended: event.Event) -> None:
        """Of no use: what follows at once is told by the next beginning, or by the end of ``around``."""

    def _write(self, line: str) -> None:
        stream = _standard_error()
        if self.listener is not None or self._silent or stream is None:
            return
        if not self._teller:
            self._teller = _LOCKS.take("teller") and (_LOCKS.usable or multiprocessing.parent_process() is None)
            self._silent = not self._teller
        if self._silent:
            return
        # A live line only where nothing else writes: a spinner puts itself in the place of sys.stderr.
        alone = stream is sys.__stderr__
        if alone and stream.isatty():
            line = line[: shutil.get_terminal_size().columns - 1]
            stream.write("\r" + line.ljust(self._width))
            self._width = len(line)
        elif not self._said:
            stream.write(line.partition(":")[0] + " (half a minute)\n")
            self._said = True
        stream.flush()

    def _end(self) -> None:
        stream = _standard_error()
        if self._width and stream is not None:
            stream.write("\r" + " " * self._width + "\r")
            stream.flush()
        self._width = 0
        if self._teller:
            self._teller = False
            _LOCKS.drop("teller")


_LOCKS = _Locks()
_VOICE = _Voice()
event.register("numba:compile", _VOICE)
