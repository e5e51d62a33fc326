"""Run each job in a process of its own, several at a time.

A process pool would lose all pending jobs when one worker is killed (docs/notebook/lab_notes.md). Here only the job of
the killed process is affected, and it is retried.
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
    command: Sequence[str] = WORKER,  # arguments of the interpreter before the run directory
) -> list[Outcome]:
    """Run all jobs, each in its own process with an equal share of the cores.

    A job whose worker was killed or exceeded the time limit is retried after all others. A job that failed with an
    error is not retried, and is reported with the last line of its log. On KeyboardInterrupt or another exception here,
    all workers are stopped and their temporary folders removed before the exception propagates.
    """
    slots = count_slots(len(jobs), limits)
    environment = worker_environment(slots)
    environment["PYTHONPATH"] = os.pathsep.join(search_path())
    (directory / LOGS).mkdir(parents=True, exist_ok=True)
    waiting = [(job, 1) for job in reversed(jobs)]  # (job, number of the attempt)
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
    """Return the number of processes at a time: ``limits.workers`` or one per core, at most one per job."""
    return max(1, min(jobs, limits.workers or core_count()))


ENGINE = Engine(run_local, slots=count_slots, check=lambda limits: None)
