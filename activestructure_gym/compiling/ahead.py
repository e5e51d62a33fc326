"""Compile ahead: other processes call what needs kernels, while this one loads or does something else.

Such a process is ``python -P -m activestructure_gym.compiling PARENT CALL...``; a call is ``module:function``, or
``module:function ARGUMENT`` with a JSON value. It prints the name of each kernel that it compiles and leaves only the
kernels' cache files. It ends with its last call or with its parent. Kernels are locked one by one, so each is compiled
once (`locks`).

There are two uses. `compiling_beside` compiles before the runs of a comparison. `start_helper` starts one process with
the first kernel that any program has to compile; ``ASG_COMPILE_AHEAD=0`` in the environment switches that off.
"""

from __future__ import annotations

import atexit
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from activestructure_gym.compiling import files
from activestructure_gym.compiling.locks import LOCKS
from activestructure_gym.compiling.progress import told_to
from activestructure_gym.cores import core_count

SWITCH = "ASG_COMPILE_AHEAD"
FIRST_USE = "activestructure_gym.first_use"  # its functions call the kernels of a first episode
_LOCK = "helper"
_LINE = "compiling "  # before the name of a kernel, on standard output
_GLANCE_S = 0.5  # between checks that the parent runs
_PATIENCE_S = 120.0  # without a new kernel; a policy or feature of a user may never end
_GRACE_S = 5.0  # between asking a process to stop and killing it
_started: list[bool] = []  # a process starts one helper at most


def start_helper() -> None:
    """Start a process that compiles ahead, where that can help and no other does already."""
    if _started:
        return
    _started.append(True)
    an_interpreter = Path(sys.executable or "").name.startswith("python") and not getattr(sys, "frozen", False)
    if os.environ.get(SWITCH) == "0" or core_count() < 2 or not an_interpreter or files.not_kept:
        return
    if multiprocessing.parent_process() is not None or LOCKS.is_held(_LOCK) or not LOCKS.usable:
        return
    # Who uses the rasteriser alone needs no more. An episode begins with the sensor and goes on for long with planes.
    of_episode = ["motion", "views", "score", "sensing"] if "activestructure_gym.volume" in sys.modules else []
    calls = [f"{__name__}:be_the_helper", *(f"{FIRST_USE}:{part}" for part in ("rasteriser", *of_episode))]
    with suppress(OSError):  # no more processes allowed
        process = _start(calls, stdout=subprocess.DEVNULL)
        atexit.register(_dismiss, process, os.getpid(), grace=0.0)


def be_the_helper() -> None:
    """Hold the helpers' lock until this process ends; end it if another process holds the lock."""
    if not LOCKS.take(_LOCK) or not LOCKS.usable:
        sys.exit()


@contextmanager
def compiling_beside(
    calls: Sequence[Sequence[str]], listen: Callable[[str], None], more: Mapping[str, str] = {}
) -> Iterator[list[bool]]:
    """Let a process per sequence of ``calls`` compile while the block runs, and wait for all of them at its end.

    ``listen`` gets the name of each kernel that they compile; ``more`` is added to their environment. The list that is
    yielded says for each process, in the end, whether it succeeded.
    """
    succeeded: list[bool] = []
    processes = [_start(each, more, stdout=subprocess.PIPE) for each in calls]
    last = [time.monotonic()]  # when a kernel was heard of

    def hear(lines: Any) -> None:
        for line in lines:
            if line.startswith(_LINE):
                last[0] = time.monotonic()
                listen(line.removeprefix(_LINE).strip())

    try:
        for process in processes:
            threading.Thread(target=hear, args=(process.stdout,), daemon=True).start()
        yield succeeded
        succeeded += [_wait(process, last) for process in processes]
    finally:
        for process in processes:
            _dismiss(process, os.getpid())


def _start(calls: Sequence[str], more: Mapping[str, str] = {}, *, stdout: int) -> subprocess.Popen[str]:
    path = os.pathsep.join(os.path.abspath(entry) for entry in sys.path)  # it finds all modules where its parent does
    return subprocess.Popen(
        [sys.executable, "-P", "-m", __package__, str(os.getpid()), *calls],
        env={**os.environ, **more, "PYTHONPATH": path, "PYTHONIOENCODING": "utf-8"},
        stdin=subprocess.DEVNULL,
        stdout=stdout,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C reaches it through the end of its parent
        text=True,
        encoding="utf-8",
    )


def _wait(process: subprocess.Popen[str], last: Sequence[float]) -> bool:
    """Return whether a process succeeds; False too if it goes on without compiling anything."""
    began = time.monotonic()
    while process.poll() is None:
        if time.monotonic() - max(began, *last) > _PATIENCE_S:
            return False
        with suppress(subprocess.TimeoutExpired):
            process.wait(_GLANCE_S)
    return process.returncode == 0


def _dismiss(process: subprocess.Popen[str], parent: int, grace: float = _GRACE_S) -> None:
    """End a process, after ``grace`` seconds by force, and what it has started."""
    if os.getpid() != parent:  # a fork of it
        return
    process.terminate()
    with suppress(subprocess.TimeoutExpired):
        process.wait(grace)
    with suppress(OSError, AttributeError):  # nothing of it is left; Windows has no groups
        assert process.pid > 1
        os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.wait()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_GLANCE_S)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_GRACE_S)
    os._exit(1)


def main(parent: int, calls: Sequence[str]) -> None:
    """Make the calls in order; standard output gets a line per kernel."""
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # temporary files are removed
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    with told_to(lambda name: print(_LINE + name, flush=True)):
        for call in calls:
            name, _, argument = call.partition(" ")
            module, _, function = name.partition(":")
            getattr(import_module(module), function)(*([json.loads(argument)] if argument else []))
