"""Locks between processes, so that of several that start together one compiles a kernel and the others load it.

The locks are ranges of one file beside the cache and end with their process, however it ends.
"""

from __future__ import annotations

import os
import struct
import sys
import time
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from activestructure_gym.compiling.files import cache_place
from activestructure_gym.errors import InputWarning

try:
    import fcntl
except ImportError:  # Windows: every process compiles for itself
    fcntl = None  # type: ignore[assignment]

_PATIENCE = 120.0  # seconds, for one kernel of another process: many times the slowest
_GLANCE = 0.02  # seconds between two tries
_SILENCE = 20.0  # seconds of waiting, after which it is said for whom
_FLOCK = "hhqqi"  # struct flock of Linux: type, whence, start, length, process


class Locks:
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
                self._file = os.open(_lock_path(), os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
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

    def is_held(self, name: str) -> bool:
        """Whether another process holds it."""
        free = self.take(name)
        if free:
            self.drop(name)
        return not free

    def holder(self, name: str) -> int:
        """The process that holds the lock; 0 where none does or the system does not say."""
        if self._file is None or sys.platform != "linux":
            return 0
        asked = struct.pack(_FLOCK, fcntl.F_WRLCK, os.SEEK_SET, zlib.crc32(name.encode()), 1, 0)
        kind, *_, process = struct.unpack(
            _FLOCK, fcntl.fcntl(self._file, fcntl.F_GETLK, asked)[: struct.calcsize(_FLOCK)]
        )
        return 0 if kind == fcntl.F_UNLCK else process

    @contextmanager
    def held(self, name: str, waiting: Callable[[], None]) -> Iterator[None]:
        """Wait for the lock, calling ``waiting`` now and then, and hold it while the block runs."""
        began, said = time.monotonic(), False
        while not self.take(name):
            waited = time.monotonic() - began
            if waited > _PATIENCE:  # its holder is stopped, or the file system keeps locks of ended processes
                self.usable = False
                break
            if waited > _SILENCE and not said:
                said = True
                who = _described(self.holder(name))
                text = f"waiting up to {_PATIENCE:.0f} s for {who}, which loads or compiles {name}"
                warnings.warn(text, InputWarning, stacklevel=2)
            waiting()
            time.sleep(_GLANCE)
        try:
            yield
        finally:
            self.drop(name)


def _described(process: int) -> str:
    """A process with its state, as a person knows it."""
    if not process:
        return "another process"
    with suppress(OSError, IndexError):
        state = (
            Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[0]
        )
        return f"process {process}{', which is stopped' if state == 'T' else ''}"
    return f"process {process}"


def _lock_path() -> str:
    """Beside the cache of this room; raises RuntimeError where there is none."""
    place = cache_place()
    if place is None:
        raise RuntimeError("no directory for compiled kernels")
    return str(place / "activestructure_gym-kernels.lock")


LOCKS = Locks()
