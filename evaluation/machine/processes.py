"""Query the processes of this machine: running or not, processor time, members of a session; and end a session."""

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
# Environment of a Python process whose output is read as text: UTF-8 regardless of the locale.
UTF_8 = {"PYTHONIOENCODING": "utf-8:backslashreplace"}


@cache
def machine_id() -> str:
    """Return six hex digits that identify this machine within a cluster without showing its name."""
    return hashlib.sha256(platform.node().encode()).hexdigest()[:6]


def processor_seconds() -> float:
    """Return the processor seconds of this process and of all its descendants, running or ended.

    Without ``/proc``, running descendants are not counted.
    """
    own = os.times()
    seconds = own.user + own.system + own.children_user + own.children_system
    children: dict[int, list[int]] = {}
    spent: dict[int, float] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            # The name may contain blanks and brackets, so fields are counted after the last bracket. There field 0 is
            # the state, 1 the parent, 11 to 14 the user and system time of the process and of its ended children.
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
    """Return whether a process of this machine is running."""
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
    """Kill all processes in the session of an ended process, and return their names.

    Without ``/proc``, the leader's process group is killed and the list is empty. Daemons in a session of their own are
    not found.
    """
    if os.name != "posix" or leader <= 1:
        return []
    ended: dict[int, str] = {}
    deadline = time.monotonic() + _DYING_S
    while (found := session_members(leader)) and time.monotonic() < deadline:  # a process may fork before it is killed
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
    """Return the names of a session's running processes by id, without its leader; empty without ``/proc``."""
    found = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError, ValueError, IndexError):  # the process has just ended
            head, _, tail = stat.read_text(encoding="utf-8", errors="replace").rpartition(")")
            state, _, _, session = tail.split()[:4]
            process = int(stat.parent.name)
            if int(session) == leader != process and state not in "ZX":
                found[process] = head.partition("(")[2]
    return found
