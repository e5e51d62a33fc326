"""A second process that compiles ahead (`activestructure_gym.compile_ahead`), started with the first kernel.

Only where there is a second core and what it compiles can be kept. It is silent, ends when all is compiled or its
parent has ended, and leaves nothing but the files of kernels. ``ASG_COMPILE_AHEAD=0`` in the environment switches it
off; in the list of processes it goes by its name: ``python -P -m activestructure_gym.compile_ahead``.
"""

from __future__ import annotations

import atexit
import multiprocessing
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from activestructure_gym.compiling import files
from activestructure_gym.compiling.locks import LOCKS
from activestructure_gym.cores import core_count

SWITCH = "ASG_COMPILE_AHEAD"
_LOCK = "helper"
_OURS = __name__.partition(".")[0]
_started: list[bool] = []  # a process looks for help once


def start_helper() -> None:
    """Start a process that compiles ahead, where that can help and nobody does already."""
    if _started:
        return
    _started.append(True)
    an_interpreter = Path(sys.executable or "").name.startswith("python") and not getattr(sys, "frozen", False)
    if os.environ.get(SWITCH) == "0" or core_count() < 2 or not an_interpreter or files.not_kept:
        return
    if multiprocessing.parent_process() is not None or LOCKS.is_held(_LOCK) or not LOCKS.usable:
        return
    # Who uses the rasteriser alone needs no more. An episode begins with the sensor and goes on for long with planes.
    of_episode = ["motion", "views", "score", "sensing"] if f"{_OURS}.volume" in sys.modules else []
    path = os.pathsep.join(os.path.abspath(entry) for entry in sys.path)  # it finds everything where its parent does
    with suppress(OSError):  # no more processes allowed
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", f"{_OURS}.compile_ahead", str(os.getpid()), "rasteriser", *of_episode],
            env={**os.environ, "PYTHONPATH": path},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C reaches it through its parent's end
        )
        atexit.register(_dismiss, process, os.getpid())


def _dismiss(process: subprocess.Popen[bytes], parent: int) -> None:
    if os.getpid() == parent:  # not a fork of it
        process.kill()
        process.wait()


@contextmanager
def only_helper() -> Iterator[bool]:
    """Hold the helpers' lock while the block runs; yields False if another process holds it."""
    free = LOCKS.take(_LOCK) and LOCKS.usable
    try:
        yield free
    finally:
        if free:
            LOCKS.drop(_LOCK)
