"""Locks between processes, so that of several that start together one compiles a kernel and the others load it.

The locks are ranges of one file beside the cache and end with their process, however it ends.
"""

from __future__ import annotations

import os
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from activestructure_gym.compiling.files import cache_place

try:
    import fcntl
except ImportError:  # Windows: every process compiles for itself
    fcntl = None  # type: ignore[assignment]

_PATIENCE = 120.0  # seconds, for one kernel of another process: many times the slowest
_GLANCE = 0.02  # seconds between two tries


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

    def is_held(self, name: str) -> bool:
        """Whether another process holds it."""
        free = self.take(name)
        if free:
            self.drop(name)
        return not free

    @contextmanager
    def held(self, name: str, waiting: Callable[[], None]) -> Iterator[None]:
        """Wait for the lock, calling ``waiting`` now and then, and hold it while the block runs."""
        began = time.monotonic()
        while not self.take(name):
            if (
                time.monotonic() - began > _PATIENCE
            ):  # its holder is stopped, or the file system keeps locks of the dead
                self.usable = False
                break
            waiting()
            time.sleep(_GLANCE)
        try:
            yield
        finally:
            self.drop(name)


def _lock_path() -> str:
    """Beside the cache of this room; raises RuntimeError where there is none."""
    place = cache_place()
    if place is None:
        raise RuntimeError("no directory for compiled kernels")
    return str(place / "activestructure_gym-kernels.lock")


LOCKS = Locks()
