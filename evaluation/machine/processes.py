"""Which processes of this machine are alive, and how much processor time they took."""

from __future__ import annotations

import hashlib
import os
import platform
from functools import cache
from pathlib import Path

# In the environment of a Python process whose output is read as text, whatever the encoding of this process's.
UTF_8 = {"PYTHONIOENCODING": "utf-8:backslashreplace"}


@cache
def machine_mark() -> str:
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
