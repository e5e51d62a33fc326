"""Run one attempt at a job in a process: start it, read its progress, enforce the time limit, return the result.

The attempt ends when its process ends, even if another process still holds its pipe open. Then all processes of its
session are killed.
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
from activestructure_gym.evaluation.archive.completion import JOBS, is_done
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.archive.temporary import remove_leftovers, unlinked
from activestructure_gym.evaluation.machine.processes import UTF_8, end_session
from activestructure_gym.evaluation.running.engines.base import LOGS
from activestructure_gym.evaluation.running.engines.failure_text import failure_text
from activestructure_gym.evaluation.running.episode import Progress

# -P: do not prepend a folder to the module search path, so that the worker imports the same files as its supervisor.
WORKER = ("-P", "-m", "activestructure_gym.evaluation.running.worker")
GRACE_SECONDS = 5.0  # time for a worker to stop before it is killed
_DRAIN_SECONDS = 1.0  # time to read the last output of an ended process

# (name of the job, line of output); the line is None when the process has ended.
Messages = queue.SimpleQueue[tuple[str, str | None]]


@dataclass(frozen=True)
class Ended:
    """Hold the result of an attempt at a job."""

    error: str | None = None  # None: the run directory is complete
    lost: bool = False  # killed, or stopped at the time limit: another attempt may succeed


class WorkerProcess:
    """Run a job in a process and watch it."""

    def __init__(
        self,
        job: Job,
        directory: Path,
        messages: Messages,
        *,
        environment: Mapping[str, str],
        command: Sequence[str] = WORKER,  # arguments of the interpreter before the run directory
        minutes: float = 0.0,  # time limit; 0 = none
        attempt: int = 1,
        keep_open: Sequence[int] = (),  # file descriptors that the process inherits and keeps open
    ) -> None:
        self.job, self.directory, self._minutes = job, directory, minutes
        self._deadline = time.monotonic() + 60 * minutes if minutes else None
        self._overdue = False
        self._over = threading.Event()  # the process has ended
        self._message_lock = threading.Lock()  # no line follows the message that the process has ended
        self._left_behind: list[str] = []  # processes of its session that were killed after its end
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
            # Ctrl-C in a terminal reaches the whole process group. A new session excludes the worker, which we stop.
            start_new_session=True,
            pass_fds=tuple(keep_open) if os.name == "posix" else (),
        )
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(job.as_dict()) + "\n")
            self._process.stdin.flush()  # the pipe stays open: a worker ends when it is closed
        except BrokenPipeError:
            pass  # the process ended at once; its log has the reason
        threading.Thread(target=self._await_end, args=(messages,), daemon=True).start()

    def seconds_left(self) -> float | None:
        """Return the seconds until the next time limit, None without one; stop a process that exceeds its limit.

        Such a process is terminated first, and killed after `GRACE_SECONDS`.
        """
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
        """Wait for the process, kill it after `GRACE_SECONDS`, and remove its temporary folder."""
        if not self._over.wait(GRACE_SECONDS):
            self._process.kill()
            self._over.wait()
        self._close()

    def finish(self) -> Ended:
        """Return the result of the attempt. Call this after the process has ended."""
        log, code = Path(self._log.name), self._process.returncode
        words = failure_text(log, self._log_start, code)
        if self._left_behind:
            number = pluralised(len(self._left_behind), "process", "processes")
            line = f"ended with this run: {number} that it had started: {', '.join(self._left_behind)}"
            self._log.seek(0, os.SEEK_END)
            self._log.write(f"{line}\n".encode())
        self._close()
        # A complete result counts even if the process failed afterwards.
        if is_done(run_directory(self.directory, self.job), self.job):
            if not log.stat().st_size:
                log.unlink()
            return Ended()
        if self._overdue:
            return Ended(f"stopped after {self._minutes:g} min (--timeout-min)", lost=True)
        # Exit codes above 128 mean that a signal asked the process to end.
        return Ended(words, lost=code < 0 or code > 128)

    def _close(self) -> None:
        self._log.close()
        if self._process.stdin is not None:
            with suppress(BrokenPipeError):
                self._process.stdin.close()
        remove_leftovers(self.directory / JOBS, self.job.name)

    def _await_end(self, messages: Messages) -> None:
        """Forward the output of the process until it ends, even if another process still holds the pipe open."""
        reader = threading.Thread(target=self._listen, args=(messages,), daemon=True)
        reader.start()
        if hasattr(os, "waitid"):  # WNOWAIT keeps the process id reserved until the session has ended
            with suppress(ChildProcessError):
                os.waitid(os.P_PID, self._process.pid, os.WEXITED | os.WNOWAIT)
        else:
            self._process.wait()
        self._left_behind = end_session(self._process.pid)
        self._process.wait()
        reader.join(_DRAIN_SECONDS)
        with self._message_lock:
            self._over.set()
            messages.put((self.job.name, None))

    def _listen(self, messages: Messages) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            for line in lines:
                with self._message_lock:
                    if not self._over.is_set():
                        messages.put((self.job.name, line))


def next_message(messages: Messages, workers: Iterable[WorkerProcess]) -> tuple[str, str | None]:
    """Wait for the next message of any worker; meanwhile stop workers that exceed their time limit."""
    while True:
        times = [left for worker in workers if (left := worker.seconds_left()) is not None]
        try:
            return messages.get(timeout=min(times, default=None))
        except queue.Empty:
            continue


def read_progress(line: str) -> Progress | None:
    """Parse the progress in a line of a worker's output; return None for any other line, such as a truncated one."""
    try:
        return Progress(**json.loads(line))
    except (json.JSONDecodeError, TypeError):
        return None


def search_path() -> list[str]:
    """Return this process's module search path, so that workers find the same modules."""
    # Ray prepends private copies of other packages, which are left out.
    return [path or os.getcwd() for path in sys.path if not path.endswith("thirdparty_files")]
