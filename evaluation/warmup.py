"""Compiling the kernels before the clock of any run starts, while the scenes are prepared.

``python -m activestructure_gym.evaluation.warmup`` is the process that does it.
"""

from __future__ import annotations

import dataclasses
import json
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from activestructure_gym.evaluation.jobs import Job
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.threads import core_count, worker_environment

_MARK = "compiling"  # before the name of a kernel, on standard output
_FRAMES = 12  # enough for a few decisions, a path and two keyframes on it


@contextmanager
def warming_up(
    policies: Sequence[str], overrides: Mapping[str, Any], notify: Callable[[str], None] = lambda _: None
) -> Iterator[None]:
    """Run the smallest possible job in another process while the block runs, and wait for it at the end.

    Compiled kernels are kept on disk, so the first run of a comparison need not compile again, and no run's time
    contains a compilation. Half of the compiling is the rasteriser's: it gets a process of its own. Results are
    thrown away, and so are failures: a real job that fails will say why. ``notify`` hears how far the compiling is, in
    this process too; nothing where all is compiled.
    """
    from activestructure_gym.compiling import told_to

    job = json.dumps(smallest_job(policies, overrides).as_dict())
    tally = _Tally(notify)
    processes = [_start(part, job, tally) for part in ("map", "world")]
    try:
        with told_to(tally):
            yield
        for process in processes:
            process.wait()
    finally:
        for process in processes:
            process.terminate()
            process.wait()


class _Tally:
    """Puts together what several processes compile; each kernel counts once."""

    def __init__(self, notify: Callable[[str], None]) -> None:
        self._notify = notify
        self._names: set[str] = set()
        self._began = time.monotonic()
        self._lock = threading.Lock()

    def __call__(self, name: str) -> None:
        from activestructure_gym.compiling import describe

        with self._lock:
            self._names.add(name)
            self._notify(describe(len(self._names), time.monotonic() - self._began))


def _start(part: str, job: str, tally: Callable[[str], None]) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-m", "activestructure_gym.evaluation.warmup", part],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=worker_environment(slots=core_count()),
        text=True,
        start_new_session=True,  # Ctrl-C reaches it through us
    )
    assert process.stdin is not None
    threading.Thread(target=_listen, args=(process, tally), daemon=True).start()
    try:
        process.stdin.write(job + "\n")
        process.stdin.close()
    except BrokenPipeError:
        pass  # it died at once
    return process


def _listen(process: subprocess.Popen[str], tally: Callable[[str], None]) -> None:
    assert process.stdout is not None
    with process.stdout as lines:
        for line in lines:
            mark, _, name = line.strip().partition(" ")
            if mark == _MARK:
                tally(name)


def smallest_job(policies: Sequence[str], overrides: Mapping[str, Any]) -> Job:
    """A few frames in the box room with small images, for the policy that asks for the most gains."""
    from activestructure_gym.policies import POLICIES

    return Job(
        scene="box",
        policy=max(policies, key=lambda name: len(POLICIES.get(name).required_gains)),
        seed=0,
        preset="fast",
        frame_budget=_FRAMES,
        overrides=tuple(overrides.items()),
        protocol=dataclasses.replace(StandardProtocol(), views=1, view_width=64, view_height=36, surface_samples=2000),
    )


def main(part: str) -> None:
    """One half of the compiling; the half without the map ends with the job on standard input.

    Standard output says which kernel is compiled, one per line.
    """
    from activestructure_gym.compile_ahead import compile_map, compile_motion, compile_sensing, compile_views
    from activestructure_gym.compiling import told_to
    from activestructure_gym.evaluation.episode import run_job

    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # so that the directory is removed
    job = Job.from_dict(json.loads(sys.stdin.readline()))
    with told_to(lambda name: print(_MARK, name, flush=True)):
        if part == "map":
            compile_map()
            return
        compile_sensing()
        compile_motion()
        compile_views()
        with tempfile.TemporaryDirectory(prefix="asg-warm-up-") as directory:
            run_job(job, Path(directory) / "run")


if __name__ == "__main__":
    main(sys.argv[1])
