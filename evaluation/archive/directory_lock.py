"""Lock a comparison's directory, so that only one supervisor writes into it.

The lock is an advisory lock of the operating system on a file that is never deleted. Workers on this machine inherit
the open file. The lock is released when the supervisor and all its workers have ended, even if they were killed. So no
other process of this machine writes into a locked directory.
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
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)  # the target of a symbolic link would be truncated
_PATIENCE = 15.0  # seconds for the workers of a killed supervisor to end; longer than `worker._GRACE_SECONDS`
_TICK = 0.1  # seconds between two attempts
_BYTE = 1 << 20  # offset of the byte locked on Windows, behind the content: a locked byte cannot be read there


@contextmanager
def hold(directory: Path, *, shared: bool = False) -> Iterator[int]:
    """Create ``directory`` and lock it while the block runs; yield the file descriptor that holds the lock.

    Several ``shared`` locks can exist at once; they exclude an exclusive lock. If a running supervisor holds the lock,
    `InputError` is raised. If only workers of a killed supervisor are left, the function waits for them to end. On file
    systems without locks it has no effect.
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
            with suppress(OSError):  # closing is not enough: a daemon started by a run may have inherited the file
                fcntl.flock(descriptor, fcntl.LOCK_UN)
        os.close(descriptor)


@contextmanager
def alone(file: Path) -> Iterator[None]:
    """Run the block with an exclusive lock on ``file``, which is created; wait for other holders.

    It is for short changes by the holders of a shared lock. On file systems without locks it has no effect.
    """
    descriptor = None
    with suppress(OSError):
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT | _NO_LINK, 0o666)
        if fcntl is not None:
            fcntl.flock(descriptor, fcntl.LOCK_EX)
    try:
        yield
    finally:
        if descriptor is not None:
            os.close(descriptor)


def check_free(directory: Path, *, shared: bool = False) -> None:
    """Raise `InputError` if a lock on ``directory`` excludes a new one, ``shared`` or exclusive; write nothing."""
    try:
        descriptor = os.open(directory / LOCK, os.O_RDWR | _NO_LINK)
    except OSError:
        return  # missing, or not writable: the caller reports that itself
    try:
        _take(descriptor, directory, shared=shared)
    finally:
        os.close(descriptor)


def _take(descriptor: int, directory: Path, *, shared: bool = False) -> None:
    waited = 0.0  # counted in ticks, so that time in which the machine is suspended does not count
    while not _try(descriptor, shared=shared):
        process, _, machine = _owner(descriptor).partition(" ")
        if not process.isdigit() or machine != machine_id() or is_alive(int(process)):
            who = f"process {process}" if machine == machine_id() else "a process of another machine"
            raise InputError(f"{who} is at work in '{directory}': wait until it has ended, or choose another --out")
        if waited > _PATIENCE:
            raise InputError(
                f"process {process} was killed, but runs that it started are still active in '{directory}': try again "
                "in a moment, or end them yourself"
            )
        time.sleep(_TICK)
        waited += _TICK


def _try(descriptor: int, *, shared: bool = False) -> bool:
    """Take the lock if it is free; return whether it was taken or cannot exist here."""
    try:
        if fcntl is not None:
            fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        elif not shared:  # Windows has no shared locks
            import msvcrt

            os.lseek(descriptor, _BYTE, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
    except OSError as error:
        return error.errno not in (errno.EAGAIN, errno.EACCES, errno.EDEADLK)
    return True


def _owner(descriptor: int) -> str:
    os.lseek(descriptor, 0, os.SEEK_SET)
    return os.read(descriptor, 64).decode(errors="replace")
