"""Which processes of this machine are alive, how much processor time they took, and how to end what one left behind."""

from __future__ import annotations

import hashlib
import os
import platform
import signal
import time
from contextlib import suppress
from functools import cache
from pathlib import Path

_DYING_S = 1.0  # a killed process is gone by then
# In the environment of a Python process whose output is read as text, whatever the encoding of this process's.
UTF_8 = {"PYTHONIOENCODING": "utf-8:backslashreplace"}


@cache
def machine_id() -> str:
    """Six hex digits that tell this machine from the others of a cluster, and give no name away."""
    return hashlib.sha256(platform.node().encode()).hexdigest()[:6]


def processor_seconds() -> float:
    """Processor time of this process, of its descendants that live and of those that have ended.

    Without a ``/proc`` those that live are left out until they have ended.
    """
    own = os.times()
    seconds = own.user + own.system + own.children_user + own.children_system
    children: dict[int, list[int]] = {}
    spent: dict[int, float] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            # The name may hold blanks and brackets; what follows the last bracket does not. Counted from the state:
            # parent 1, then user, system and waited-for children's user and system time from 11 on.
            fields = stat.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
            process = int(stat.parent.name)
            children.setdefault(int(fields[1]), []).append(process)
            spent[process] = sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
        except (OSError, ValueError, IndexError):  # it has just ended
            continue
    waiting = list(children.get(os.getpid(), ()))
    while waiting:
        process = waiting.pop()
        seconds += spent.get(process, 0.0)
        waiting += children.get(process, ())
    return seconds


def is_alive(process: int) -> bool:
    """Whether a process of this machine lives."""
    if os.name != "posix":  # there os.kill(process, 0) would end the process
        return process == os.getpid()
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True


def end_session(leader: int) -> list[str]:
    """Kill what still runs in the session of a process that has ended, and return the names of these processes.

    Without a ``/proc`` the leader's process group is killed, and the list is empty. A daemon has left the session.
    """
    if os.name != "posix" or leader <= 1:
        return []
    ended: dict[int, str] = {}
    deadline = time.monotonic() + _DYING_S
    while (found := session_members(leader)) and time.monotonic() < deadline:  # one may fork while it is killed
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
    """The living processes of a session except its leader, with their names; none without a ``/proc``."""
    found = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError, ValueError, IndexError):  # it has just ended
            head, _, tail = stat.read_text(encoding="utf-8", errors="replace").rpartition(")")
            state, _, _, session = tail.split()[:4]
            process = int(stat.parent.name)
            if int(session) == leader != process and state not in "ZX":
                found[process] = head.partition("(")[2]
    return found
