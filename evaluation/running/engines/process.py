"""One attempt at one job in a process of its own: started, listened to, stopped in time, and judged by what it left."""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from activestructure_gym.evaluation.archive.comparison import run_directory
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.archive.parts import remove_parts
from activestructure_gym.evaluation.archive.store import JOBS, is_done
from activestructure_gym.evaluation.machine.processes import UTF_8
from activestructure_gym.evaluation.running.engines.base import LOGS
from activestructure_gym.evaluation.running.episode import Progress

# -P: nothing in front of the search path that it is given, so that it imports what its supervisor looked at.
WORKER = ("-P", "-m", "activestructure_gym.evaluation.running.worker")
GRACE_SECONDS = 5.0  # between asking a worker to stop and killing it

# (name of the job, a line it wrote); None for the line: it wrote its last.
Messages = queue.SimpleQueue[tuple[str, str | None]]


@dataclass(frozen=True)
class Ended:
    """The end of an attempt at a job."""

    error: str | None = None  # None: the run directory is whole
    lost: bool = False  # killed or out of time, which says nothing about the next attempt


class WorkerProcess:
    """A running process and the job it works on."""

    def __init__(
        self,
        job: Job,
        directory: Path,
        messages: Messages,
        *,
        environment: Mapping[str, str],
        command: Sequence[str] = WORKER,  # what the interpreter runs, before the run directory
        minutes: float = 0.0,  # until it is stopped; 0 = never
        attempt: int = 1,
        keep_open: Sequence[int] = (),  # descriptors it keeps open while it lives
    ) -> None:
        self.job, self.directory, self._minutes = job, directory, minutes
        self._deadline = time.monotonic() + 60 * minutes if minutes else None
        self._overdue = False
        path = directory / LOGS / f"{job.name}.log"
        path.parent.mkdir(parents=True, exist_ok=True)
        self._log = open(path, "wb" if attempt == 1 else "ab")
        self._log_start = self._log.tell()
        self._process = subprocess.Popen(
            [sys.executable, *command, str(run_directory(directory, job))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            env={**environment, **UTF_8},
            text=True,
            encoding="utf-8",
            # Ctrl-C in a terminal goes to the whole group; the workers are stopped by us, in order.
            start_new_session=True,
            pass_fds=tuple(keep_open) if os.name == "posix" else (),
        )
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(job.as_dict()) + "\n")
            self._process.stdin.flush()  # and left open: a worker ends when this pipe does
        except BrokenPipeError:
            pass  # it died at once; its log says why
        threading.Thread(target=self._listen, args=(messages,), daemon=True).start()

    def seconds_left(self) -> float | None:
        """Seconds until the next time limit, None without one; a process past its limit is terminated, then killed."""
        if self._deadline is None:
            return None
        left = self._deadline - time.monotonic()
        if left > 0:
            return left
        if self._overdue:
            self._process.kill()
            self._deadline = None
            return None
        self._process.terminate()
        self._overdue = True
        self._deadline = time.monotonic() + GRACE_SECONDS
        return GRACE_SECONDS

    def ask_to_stop(self) -> None:
        """Send SIGTERM."""
        self._process.terminate()

    def stop(self) -> None:
        """Wait for the process, kill it after `GRACE_SECONDS`, and remove its half-written files."""
        try:
            self._process.wait(GRACE_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._log.close()
        remove_parts(self.directory / JOBS, self.job.name)

    def finish(self) -> Ended:
        """Outcome of the attempt; call it when the process has closed its output."""
        self._log.close()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                try:
                    stream.close()
                except BrokenPipeError:
                    pass
        remove_parts(self.directory / JOBS, self.job.name)
        log, code = Path(self._log.name), self._process.returncode
        # However it ended: a result that is whole counts, and is not computed twice.
        if is_done(run_directory(self.directory, self.job), self.job):
            if not log.stat().st_size:
                log.unlink()
            return Ended()
        if self._overdue:
            return Ended(f"stopped after {self._minutes:g} min (--timeout)", lost=True)
        # Above 128: it was asked to end by a signal, and did so in order.
        return Ended(_last_words(log, self._log_start, code), lost=code < 0 or code > 128)

    def _listen(self, messages: Messages) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            messages.put((self.job.name, line))
        self._process.wait()
        messages.put((self.job.name, None))


def next_message(messages: Messages, workers: Iterable[WorkerProcess]) -> tuple[str, str | None]:
    """Wait for the next line of any of the workers; stops those whose time is over meanwhile."""
    while True:
        times = [left for worker in workers if (left := worker.seconds_left()) is not None]
        try:
            return messages.get(timeout=min(times, default=None))
        except queue.Empty:
            continue


def read_progress(line: str) -> Progress | None:
    """The progress in a worker's line of output; None for any other line, such as a torn one."""
    try:
        return Progress(**json.loads(line))
    except (json.JSONDecodeError, TypeError):
        return None


def search_path() -> list[str]:
    """This process's module search path, for workers to find the same modules."""
    # Ray puts private copies of other packages in front.
    return [path or os.getcwd() for path in sys.path if not path.endswith("thirdparty_files")]


def _last_words(log: Path, start: int, code: int) -> str:
    text = log.read_bytes()[start:].decode("utf-8", errors="replace")
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    how = f"killed by signal {-code}" if code < 0 else f"exit code {code}"
    return f"{lines[-1]} ({how})" if lines else f"the worker wrote nothing ({how})"
