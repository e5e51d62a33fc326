"""One operating-system process per job, several at a time.

A pool would lose every pending job when one worker dies (research/libraries.md, section 6); here a death costs the
one job, and is reported.
"""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from activestructure_gym.evaluation.engines.base import JOBS, LOGS, Listener, Outcome, run_directory
from activestructure_gym.evaluation.episode import Progress
from activestructure_gym.evaluation.jobs import Job
from activestructure_gym.evaluation.store import is_done, remove_parts
from activestructure_gym.evaluation.threads import core_count, worker_environment

WORKER = ("-m", "activestructure_gym.evaluation.worker")
_GRACE_SECONDS = 5.0  # between asking a worker to stop and killing it


@dataclass
class _Worker:
    """A running process and the job it works on."""

    job: Job
    process: subprocess.Popen[str]
    log: IO[bytes]


def run_local(
    jobs: Sequence[Job],
    directory: Path,
    listener: Listener,
    workers: int = 0,  # processes at a time; 0 = one per core, at most one per job
    *,
    command: Sequence[str] = WORKER,  # what the interpreter runs, before the run directory
) -> list[Outcome]:
    """Run all jobs, each in its own process, with the cores shared out evenly.

    A worker that dies is reported with the last line of its log, and the others go on. On KeyboardInterrupt (or any
    other error here) all workers are stopped and their half-written directories removed before it goes on upwards.
    """
    slots = max(1, min(len(jobs), workers or core_count()))
    environment = worker_environment(slots)
    # Workers find the same modules as this process, a user's policy in the working directory included.
    environment["PYTHONPATH"] = os.pathsep.join(path or os.getcwd() for path in sys.path)
    (directory / LOGS).mkdir(parents=True, exist_ok=True)
    waiting, running, outcomes = list(reversed(jobs)), dict[str, _Worker](), list[Outcome]()
    messages: queue.SimpleQueue[tuple[str, str | None]] = queue.SimpleQueue()
    try:
        while waiting or running:
            while waiting and len(running) < slots:
                worker = _start(waiting.pop(), directory, environment, command, messages)
                running[worker.job.name] = worker
            name, line = messages.get()
            if line is not None:
                _tell(listener, running[name].job, line)
                continue
            outcome = _finish(running.pop(name), directory)
            listener.ended(outcome)
            outcomes.append(outcome)
    finally:
        _stop(list(running.values()), directory)
    return outcomes


def _start(
    job: Job,
    directory: Path,
    environment: dict[str, str],
    command: Sequence[str],
    messages: queue.SimpleQueue[tuple[str, str | None]],
) -> _Worker:
    log = open(directory / LOGS / f"{job.name}.log", "wb")
    process = subprocess.Popen(
        [sys.executable, *command, str(run_directory(directory, job))],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=log,
        env=environment,
        text=True,
        encoding="utf-8",
        # Ctrl-C in a terminal goes to the whole group; the workers are stopped by us, in order.
        start_new_session=True,
    )
    assert process.stdin is not None
    try:
        process.stdin.write(json.dumps(job.as_dict()) + "\n")
        process.stdin.flush()  # and left open: a worker ends when this pipe does
    except BrokenPipeError:
        pass  # it died at once; its log says why
    threading.Thread(target=_listen, args=(job.name, process, messages), daemon=True).start()
    return _Worker(job, process, log)


def _listen(name: str, process: subprocess.Popen[str], messages: queue.SimpleQueue[tuple[str, str | None]]) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        messages.put((name, line))
    process.wait()
    messages.put((name, None))


def _tell(listener: Listener, job: Job, line: str) -> None:
    try:
        progress = Progress(**json.loads(line))
    except (json.JSONDecodeError, TypeError):
        return  # a line torn by a dying worker
    listener.progress(job, progress)


def _finish(worker: _Worker, directory: Path) -> Outcome:
    worker.log.close()
    for stream in (worker.process.stdin, worker.process.stdout):
        if stream is not None:
            try:
                stream.close()
            except BrokenPipeError:
                pass
    remove_parts(directory / JOBS, worker.job.name)
    log = Path(worker.log.name)
    if worker.process.returncode == 0 and is_done(run_directory(directory, worker.job), worker.job):
        if not log.stat().st_size:
            log.unlink()
        return Outcome(worker.job)
    return Outcome(worker.job, _last_words(log, worker.process.returncode))


def _last_words(log: Path, code: int) -> str:
    lines = [line.strip() for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    how = f"killed by signal {-code}" if code < 0 else f"exit code {code}"
    return f"{lines[-1]} ({how})" if lines else f"the worker wrote nothing ({how})"


def _stop(workers: Sequence[_Worker], directory: Path) -> None:
    for worker in workers:
        worker.process.terminate()
    for worker in workers:
        try:
            worker.process.wait(_GRACE_SECONDS)
        except subprocess.TimeoutExpired:
            worker.process.kill()
            worker.process.wait()
        worker.log.close()
        remove_parts(directory / JOBS, worker.job.name)
