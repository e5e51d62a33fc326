"""One operating-system process per job, several at a time.

A pool would lose every pending job when one worker dies (docs/notebook/groundwork.md); here a death costs the
one job, which is tried again.
"""

from __future__ import annotations

import os
import queue
from collections.abc import Sequence
from pathlib import Path

from activestructure_gym.cores import core_count
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.machine.threads import worker_environment
from activestructure_gym.evaluation.running.engines.base import LOGS, Engine, Limits, Listener, Outcome
from activestructure_gym.evaluation.running.engines.process import (
    WORKER,
    Messages,
    WorkerProcess,
    next_message,
    read_progress,
    search_path,
)


def run_local(
    jobs: Sequence[Job],
    directory: Path,
    listener: Listener,
    limits: Limits,
    *,
    keep_open: Sequence[int] = (),
    command: Sequence[str] = WORKER,  # what the interpreter runs, before the run directory
) -> list[Outcome]:
    """Run all jobs, each in its own process, with the cores shared out evenly.

    A job whose worker was killed or ran out of time is tried again when all others have had their turn; one that
    failed by itself would fail again, and is reported with the last line of its log. On KeyboardInterrupt (or any
    other error here) all workers are stopped and their half-written directories removed before it goes on upwards.
    """
    slots = count_slots(len(jobs), limits)
    environment = worker_environment(slots)
    environment["PYTHONPATH"] = os.pathsep.join(search_path())
    (directory / LOGS).mkdir(parents=True, exist_ok=True)
    waiting = [(job, 1) for job in reversed(jobs)]  # and which attempt it is
    running = dict[str, tuple[WorkerProcess, int]]()
    outcomes = list[Outcome]()
    messages: Messages = queue.SimpleQueue()
    try:
        while waiting or running:
            while waiting and len(running) < slots:
                job, attempt = waiting.pop()
                worker = WorkerProcess(
                    job, directory, messages, environment=environment, command=command, minutes=limits.timeout_min,
                    attempt=attempt, keep_open=keep_open,
                )  # fmt: skip
                running[job.name] = worker, attempt
            name, line = next_message(messages, [worker for worker, _ in running.values()])
            worker, attempt = running[name]
            if line is not None:
                if progress := read_progress(line):
                    listener.progress(worker.job, progress)
                continue
            ended = worker.finish()
            del running[name]
            if ended.lost and attempt <= limits.retries:
                listener.on_retry(worker.job, ended.error or "")
                waiting.insert(0, (worker.job, attempt + 1))
                continue
            outcomes.append(Outcome(worker.job, ended.error, attempt))
            listener.ended(outcomes[-1])
    finally:
        for worker, _ in running.values():
            worker.ask_to_stop()
        for worker, _ in running.values():
            worker.stop()
    return outcomes


def count_slots(jobs: int, limits: Limits) -> int:
    """Processes at a time: one per core unless asked for otherwise, at most one per job."""
    return max(1, min(jobs, limits.workers or core_count()))


ENGINE = Engine(run_local, slots=count_slots, check=lambda limits: None)
