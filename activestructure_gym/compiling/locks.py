"""Lock kernels between processes: one process compiles a kernel, and the others wait and load its file.

Each lock is one byte of a common file in the cache folder. The operating system releases it when its process ends.
"""

from __future__ import annotations

import os
import time
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from activestructure_gym.compiling.files import cache_place
from activestructure_gym.errors import InputWarning

try:
    import fcntl
except ImportError:  # Windows: every process compiles for itself
    fcntl = None  # type: ignore[assignment]

_PATIENCE_S = 120.0  # longest wait for a kernel that another process compiles, seconds; no kernel needs that long
_GLANCE_S = 0.02  # seconds between two attempts to take a lock
_LOADING_S = 5.0  # loading a kernel takes less time, seconds; after that another process is compiling it


class Locks:
    """Hold named locks between processes. Every lock counts as free if the system has no file locks."""

    def __init__(self) -> None:
        self._file: int | None = None
        self.usable = fcntl is not None

    def take(self, name: str) -> bool:
        """Take the lock if it is free; return False if another process holds it."""
        if not self.usable:
            return True
        try:
            if self._file is None:
                place = cache_place()
                if place is None:
                    raise OSError("no directory for compiled kernels")
                path = place / "activestructure_gym-kernels.lock"
                self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
            # Locked bytes may be beyond the end of the file. If two names have the same byte, a process waits without
            # need.
            fcntl.lockf(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, zlib.crc32(name.encode()))
        except BlockingIOError:
            return False
        except OSError:
            self.usable = False
        return True

    def drop(self, name: str) -> None:
        """Release the lock, which this process must hold."""
        if self.usable and self._file is not None:
            fcntl.lockf(self._file, fcntl.LOCK_UN, 1, zlib.crc32(name.encode()))

    def is_held(self, name: str) -> bool:
        """Return whether another process holds the lock."""
        free = self.take(name)
        if free:
            self.drop(name)
        return not free

    @contextmanager
    def held(self, name: str, waiting: Callable[[], None]) -> Iterator[None]:
        """Wait for the lock and hold it during the block.

        Call ``waiting`` repeatedly while another process compiles.
        """
        began = time.monotonic()
        while not self.take(name):
            waited = time.monotonic() - began
            if waited > _PATIENCE_S:  # the holder is stopped, or the file system keeps the locks of ended processes
                self.usable = False
                text = f"another process has held the kernel {name} for {waited:.0f} s: it is compiled here too"
                warnings.warn(text, InputWarning, stacklevel=2)
                break
            if waited > _LOADING_S:
                waiting()
            time.sleep(_GLANCE_S)
        try:
            yield
        finally:
            self.drop(name)


LOCKS = Locks()
