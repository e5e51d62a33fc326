"""One attempt at one job in a process of its own: started, listened to, stopped in time, and judged by what it left.

The attempt ends when its process ends, whoever else holds the process's pipe open. What the process started in its
session is then killed.
"""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from activestructure_gym.errors import pluralised
from activestructure_gym.evaluation.archive.comparison import run_directory
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.archive.store import JOBS, is_done
from activestructure_gym.evaluation.archive.temporary import remove_leftovers, unlinked
from activestructure_gym.evaluation.machine.processes import UTF_8, end_session
from activestructure_gym.evaluation.running.engines.base import LOGS
from activestructure_gym.evaluation.running.engines.last_words import last_words
from activestructure_gym.evaluation.running.episode import Progress

# -P: nothing in front of the search path that it is given, so that it imports what its supervisor looked at.
WORKER = ("-P", "-m", "activestructure_gym.evaluation.running.worker")
GRACE_SECONDS = 5.0  # between asking a worker to stop and killing it
_DRAIN_SECONDS = 1.0  # after the end of a process, for what it wrote last

# (name of the job, a line it wrote); None for the line: its process has ended.
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
        self._over = threading.Event()  # the process has ended
        self._told = threading.Lock()
        self._left_behind: list[str] = []  # processes that it had started and that were ended after it
        path = directory / LOGS / f"{job.name}.log"
        path.parent.mkdir(parents=True, exist_ok=True)
        self._log = open(unlinked(path), "wb" if attempt == 1 else "ab")
        self._log_start = self._log.tell()
        self._process = subprocess.Popen(
            [sys.executable, *command, str(run_directory(directory, job)), *map(str, keep_open)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            env={**environment, **UTF_8},
            text=True,
            encoding="utf-8",
            errors="replace",
            # Ctrl-C in a terminal goes to the whole group; the workers are stopped by us, in order.
            start_new_session=True,
            pass_fds=tuple(keep_open) if os.name == "posix" else (),
        )
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(job.as_dict()) + "\n")
            self._process.stdin.flush()  # and left open: a worker ends when this pipe does
        except BrokenPipeError:
            pass  # it ended at once; its log says why
        threading.Thread(target=self._await_end, args=(messages,), daemon=True).start()

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
        if not self._over.wait(GRACE_SECONDS):
            self._process.kill()
            self._over.wait()
        self._close()

    def finish(self) -> Ended:
        """Outcome of the attempt; call it when the process has ended."""
        log, code = Path(self._log.name), self._process.returncode
        words = last_words(log, self._log_start, code)
        if self._left_behind:
            number = pluralised(len(self._left_behind), "process", "processes")
            line = f"ended with this run: {number} that it had started: {', '.join(self._left_behind)}"
            self._log.seek(0, os.SEEK_END)
            self._log.write(f"{line}\n".encode())
        self._close()
        # However it ended: a result that is whole counts, and is not computed twice.
        if is_done(run_directory(self.directory, self.job), self.job):
            if not log.stat().st_size:
                log.unlink()
            return Ended()
        if self._overdue:
            return Ended(f"stopped after {self._minutes:g} min (--timeout-min)", lost=True)
        # Above 128: it was asked to end by a signal, and did so in order.
        return Ended(words, lost=code < 0 or code > 128)

    def _close(self) -> None:
        self._log.close()
        if self._process.stdin is not None:
            with suppress(BrokenPipeError):
                self._process.stdin.close()
        remove_leftovers(self.directory / JOBS, self.job.name)

    def _await_end(self, messages: Messages) -> None:
        """Pass on what the process writes until it ends; a process that it left behind may hold the pipe for ever."""
        reader = threading.Thread(target=self._listen, args=(messages,), daemon=True)
        reader.start()
        if hasattr(os, "waitid"):  # its number stays its own until the next wait
            with suppress(ChildProcessError):
                os.waitid(os.P_PID, self._process.pid, os.WEXITED | os.WNOWAIT)
        else:
            self._process.wait()
        self._left_behind = end_session(self._process.pid)
        self._process.wait()
        reader.join(_DRAIN_SECONDS)
        with self._told:
            self._over.set()
            messages.put((self.job.name, None))

    def _listen(self, messages: Messages) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            for line in lines:
                with self._told:
                    if not self._over.is_set():
                        messages.put((self.job.name, line))


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
