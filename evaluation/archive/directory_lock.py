"""One supervisor at a time in a comparison's directory.

The lock is the operating system's, on a file that stays. It ends with the processes that have the file open, however
they end: the supervisor, and its workers on this machine, to whom the open file is handed on. So whoever holds a
directory knows that nobody else of this machine writes into it.
"""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.temporary import refuse_links
from activestructure_gym.evaluation.machine.processes import is_alive, machine_id

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

LOCK = ".lock"  # holds "<process> <machine>" of the last supervisor
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)  # it would be emptied, wherever it leads
_PATIENCE = 15.0  # seconds for the workers of a killed supervisor to end: above the grace they give themselves
_TICK = 0.1
_BYTE = 1 << 20  # which one Windows locks: it lets nobody read a locked byte


@contextmanager
def hold(directory: Path, *, shared: bool = False) -> Iterator[int]:
    """Make ``directory`` and hold it while the block runs; gives the descriptor that keeps the hold.

    A ``shared`` hold admits other shared ones and excludes all others.

    Raises `InputError` where another supervisor lives that holds it. Where only the workers of one that was killed are
    left, waits for them to end. Without effect on file systems that know no locks.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        refuse_links(directory, LOCK)
        descriptor = os.open(directory / LOCK, os.O_RDWR | os.O_CREAT | _NO_LINK, 0o666)
    except OSError as error:
        raise InputError(f"the output '{directory}' cannot be made: {error.strerror}") from error
    try:
        _take(descriptor, directory, shared=shared)
        os.ftruncate(descriptor, 0)
        os.lseek(descriptor, 0, os.SEEK_SET)
        os.write(descriptor, f"{os.getpid()} {machine_id()}".encode())
        yield descriptor
    finally:
        if fcntl is not None:
            with suppress(OSError):  # a daemon that a run has left behind may hold the same open file
                fcntl.flock(descriptor, fcntl.LOCK_UN)
        os.close(descriptor)


def check_free(directory: Path, *, shared: bool = False) -> None:
    """Raise `InputError` where a supervisor holds ``directory``; for a ``shared`` hold, only where not shared.

    Writes nothing.
    """
    try:
        descriptor = os.open(directory / LOCK, os.O_RDWR | _NO_LINK)
    except OSError:
        return  # not there; or not ours to write, which others say better
    try:
        _take(descriptor, directory, shared=shared)
    finally:
        os.close(descriptor)


def _take(descriptor: int, directory: Path, *, shared: bool = False) -> None:
    waited = 0.0  # not by the clock: time during which everything is suspended does not count
    while not _try(descriptor, shared=shared):
        process, _, machine = _owner(descriptor).partition(" ")
        if not process.isdigit() or machine != machine_id() or is_alive(int(process)):
            who = f"process {process}" if machine == machine_id() else "a process of another machine"
            raise InputError(f"{who} is at work in '{directory}': wait until it has ended, or choose another --out")
        if waited > _PATIENCE:
            raise InputError(
                f"runs that process {process} began before it was killed have not ended in '{directory}': "
                "try again in a moment, or end them yourself"
            )
        time.sleep(_TICK)
        waited += _TICK


def _try(descriptor: int, *, shared: bool = False) -> bool:
    """Take the lock if it is free."""
    try:
        if fcntl is not None:
            fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        elif not shared:  # Windows has no shared ones
            import msvcrt

            os.lseek(descriptor, _BYTE, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
    except OSError as error:
        return error.errno not in (errno.EAGAIN, errno.EACCES, errno.EDEADLK)
    return True


def _owner(descriptor: int) -> str:
    os.lseek(descriptor, 0, os.SEEK_SET)
    return os.read(descriptor, 64).decode(errors="replace")
