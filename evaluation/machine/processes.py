"""Query the processes of this machine (running or not, processor time, members of a session), and end a session."""

from __future__ import annotations

import hashlib
import os
import platform
import signal
import time
from contextlib import suppress
from functools import cache
from pathlib import Path

_DYING_S = 1.0  # seconds to wait for killed processes to end
# Environment variables for a Python process whose output this process reads as text: UTF-8 regardless of the locale.
UTF_8 = {"PYTHONIOENCODING": "utf-8:backslashreplace"}


@cache
def machine_id() -> str:
    """Return six hex digits that identify this machine within a cluster: a hash of its host name."""
    return hashlib.sha256(platform.node().encode()).hexdigest()[:6]


def processor_seconds() -> float:
    """Return the user and system time in seconds of this process and of all its descendants, running or ended.

    Without ``/proc``, running descendants are not counted.
    """
    own = os.times()
    seconds = own.user + own.system + own.children_user + own.children_system
    children: dict[int, list[int]] = {}
    spent: dict[int, float] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            # The process name may contain blanks and brackets, so fields are counted from the last bracket. Field 0 is
            # the state, 1 the parent, 11 and 12 the user and system time in clock ticks, 13 and 14 of ended children.
            fields = stat.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
            process = int(stat.parent.name)
            children.setdefault(int(fields[1]), []).append(process)
            spent[process] = sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
        except (OSError, ValueError, IndexError):  # the process has just ended
            continue
    waiting = list(children.get(os.getpid(), ()))
    while waiting:
        process = waiting.pop()
        seconds += spent.get(process, 0.0)
        waiting += children.get(process, ())
    return seconds


def is_alive(process: int) -> bool:
    """Return whether a process with this id is running on this machine; on Windows, only this process counts."""
    if os.name != "posix":  # on Windows os.kill(process, 0) would end the process
        return process == os.getpid()
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True


def end_session(leader: int) -> list[str]:
    """Kill all processes of the POSIX session that the process with the id ``leader`` has led until it ended.

    Return the killed processes as "name (id)". Without ``/proc``, the leader's process group is killed and the list is
    empty. Daemons are not found if they have started a session of their own.
    """
    if os.name != "posix" or leader <= 1:
        return []
    ended: dict[int, str] = {}
    deadline = time.monotonic() + _DYING_S
    while (found := session_members(leader)) and time.monotonic() < deadline:  # again, since a process may have forked
        ended |= found
        for process in found:
            with suppress(ProcessLookupError, PermissionError):
                os.kill(process, signal.SIGKILL)
        time.sleep(0.01)
    if not Path("/proc/self/stat").exists():
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(leader, signal.SIGKILL)
    return [f"{name} ({process})" for process, name in sorted(ended.items())]


def session_members(leader: int) -> dict[int, str]:
    """Return {process id: name} of the running processes in the POSIX session of ``leader``, without ``leader``.

    The result is empty on systems without ``/proc``.
    """
    found = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError, ValueError, IndexError):  # the process has just ended
            head, _, tail = stat.read_text(encoding="utf-8", errors="replace").rpartition(")")
            state, _, _, session = tail.split()[:4]
            process = int(stat.parent.name)
            if int(session) == leader != process and state not in "ZX":
                found[process] = head.partition("(")[2]
    return found
