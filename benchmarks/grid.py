"""Measure the overhead of `asg compare` in running jobs, relative to the same jobs started by the program ``xargs``.

The supervisor is the part of `asg compare` that starts, watches and records the processes of jobs.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.directory_lock import hold
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.cli.bench import print_rows
from activestructure_gym.evaluation.cli.options import split_scenes
from activestructure_gym.evaluation.cli.output import make_console, working
from activestructure_gym.evaluation.machine.threads import worker_environment
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.running.comparison import Comparison, run_comparison
from activestructure_gym.evaluation.running.engines.base import Limits
from activestructure_gym.evaluation.running.engines.local import count_slots
from activestructure_gym.evaluation.running.engines.process import search_path
from activestructure_gym.evaluation.running.live_progress import LiveProgress
from activestructure_gym.specs import Spec
from benchmarks.command import run

# Python program that runs one job, given the path of its JSON file and the output directory.
BY_HAND = """
import json, sys
from pathlib import Path
import cv2
from activestructure_gym.evaluation.running.episode import run_job
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.machine.threads import thread_cap
cv2.setNumThreads(thread_cap())
run_job(Job.from_dict(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))), Path(sys.argv[2]))
"""


def run_grid_benchmark(
    scenes: Sequence[str] = ("room",),
    *,
    frames: int = 60,
    seeds: Sequence[int] = (0, 1),
    repeats: int = 3,
    notify: Callable[[str], None] = lambda _: None,
) -> list[dict[str, Any]]:
    """Return wall and processor seconds by the supervisor and by ``xargs``: a row per repetition and a row of medians.

    ``overhead_%`` is the additional wall time by the supervisor and ``overhead_cpu_%`` its additional processor time.
    ``own_cpu_%`` is the processor time of the supervisor's process divided by that of its workers, which does not
    depend on the load of the machine.

    There are two jobs of ``frames`` frames per scene and seed, one per policy; ``repeats`` is the number of
    repetitions. Both methods run as many jobs at a time as there are cores, with equal limits on threads. The
    supervisor's live display is on. The preparation and the report of `asg compare` are not timed. The order of the two
    methods alternates.
    """
    if shutil.which("xargs") is None:
        raise InputError("this benchmark runs jobs by hand with xargs, which is not installed")
    conditions = Conditions(frame_budget=frames, protocol=StandardProtocol(views=8))
    comparison = Comparison([*map(Spec, scenes)], [Spec("random"), Spec("pixel_only")], seeds, conditions=conditions)
    jobs = comparison.prepare(notify)
    methods = {"by_hand": _by_hand, "supervisor": _supervised}
    rows: list[dict[str, Any]] = []
    for repeat in range(repeats):
        row: dict[str, Any] = {"repetition": str(repeat + 1), "jobs": len(jobs)}
        for name in sorted(methods, reverse=bool(repeat % 2)):
            notify(f"repetition {repeat + 1} of {repeats}: {name.replace('_', ' ')}")
            with tempfile.TemporaryDirectory(prefix="asg-bench-grid-") as directory:
                began, spent = time.perf_counter(), _processor_seconds()
                methods[name](jobs, Path(directory))
                own, workers = (after - before for after, before in zip(_processor_seconds(), spent))
                row |= {f"{name}_s": time.perf_counter() - began, f"{name}_cpu_s": own + workers}
                if name == "supervisor":
                    row["own_cpu_%"] = 100 * own / workers
        row["overhead_%"] = 100 * (row["supervisor_s"] / row["by_hand_s"] - 1)
        row["overhead_cpu_%"] = 100 * (row["supervisor_cpu_s"] / row["by_hand_cpu_s"] - 1)
        rows.append(row)
    median = {
        name: statistics.median(row[name] for row in rows) for name in rows[0] if name not in ("repetition", "jobs")
    }
    return [*rows, {"repetition": "median", "jobs": len(jobs)} | median]


def _by_hand(jobs: Sequence[Job], directory: Path) -> None:
    """Run one process per job by ``xargs``, as many at a time as there are cores."""
    slots = count_slots(len(jobs), Limits())
    lines = []
    for number, job in enumerate(jobs):
        file = directory / f"{number}.json"
        file.write_text(json.dumps(job.as_dict()), encoding="utf-8")
        lines.append(f"{file} {directory / job.name}\n")
    environment = worker_environment(slots) | {"PYTHONPATH": os.pathsep.join(search_path())}
    command = ["xargs", "-P", str(slots), "-L", "1", sys.executable, "-c", BY_HAND]
    subprocess.run(command, input="".join(lines).encode(), env=environment, check=True, capture_output=True)


def _supervised(jobs: Sequence[Job], directory: Path) -> None:
    console = Console(file=io.StringIO(), force_terminal=True, width=120)
    with hold(directory / "out") as held, LiveProgress(console) as live:
        result = run_comparison(jobs, directory / "out", live, held=held)
    if result.failed:
        raise RuntimeError(f"a run failed: {result.failed[0].error}")


def _processor_seconds() -> tuple[float, float]:
    """Return the processor seconds of this process, and of all its children that have ended."""
    import resource  # missing on Windows, which has no xargs either

    own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime, children.ru_utime + children.ru_stime


@dataclass(frozen=True)
class Grid:
    """Measure the overhead of `asg compare`: the same jobs started by xargs and by its supervisor."""

    scenes: tuple[str, ...] = ()
    """Use these scenes, separated by commas or spaces; by default room."""
    quick: bool = False
    """Run a small version, which shows only that the benchmark works."""

    def run(self) -> int:
        """Measure, print a table, and return 0."""
        console = make_console()
        size: dict[str, Any] = {"frames": 8, "seeds": (0,), "repeats": 1} if self.quick else {}
        with working(console, "measuring the grid") as notify:
            chosen = split_scenes(self.scenes) or (["box"] if self.quick else ["room"])
            rows = run_grid_benchmark(chosen, notify=notify, **size)
        print_rows(console, rows, "the same jobs by hand and through the supervisor")
        return 0


if __name__ == "__main__":
    sys.exit(run(Grid))
