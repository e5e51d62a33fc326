"""What every engine takes, tells and returns."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.running.episode import Progress

JOBS = "jobs"  # sub-directory of a comparison: one run directory per finished job
LOGS = "logs"  # sub-directory of a comparison: what the workers wrote to standard error
LONGEST_TIMEOUT = 525_600.0  # minutes; a year


@dataclass(frozen=True)
class Limits:
    """What jobs may take."""

    workers: int = 0  # jobs at a time; 0 = as many as there are cores
    timeout: float = 0.0  # minutes per attempt at a job; 0 = any time
    retries: int = 1  # further attempts at a job that was killed or ran out of time

    def __post_init__(self) -> None:
        if self.workers < 0:
            raise InputError(f"--workers is the number of runs at a time, or 0 for one per core, got {self.workers}")
        if not (math.isfinite(self.timeout) and 0 <= self.timeout <= LONGEST_TIMEOUT):
            raise InputError(f"--timeout is in minutes per run, or 0 for any time, got {self.timeout}")
        if self.retries < 0:
            raise InputError(f"--retries is how often a killed run is tried again, from 0 on, got {self.retries}")


@dataclass(frozen=True)
class Outcome:
    """How a job ended."""

    job: Job
    error: str | None = None  # None: finished, and its run directory is whole
    attempts: int = 1

    @property
    def finished(self) -> bool:
        """Whether there is a result."""
        return self.error is None


class Listener(Protocol):
    """Who is told what happens while jobs run. Called from one thread."""

    def begin(self, jobs: Sequence[Job], finished: int) -> None:
        """These jobs will run; so many more were finished before."""

    def progress(self, job: Job, progress: Progress) -> None:
        """A running job got somewhere."""

    def again(self, job: Job, error: str) -> None:
        """An attempt at a job was lost, and another one follows."""

    def ended(self, outcome: Outcome) -> None:
        """A job ended, one way or the other."""


class Run(Protocol):
    """Works off a list of jobs."""

    def __call__(
        self, jobs: Sequence[Job], directory: Path, listener: Listener, limits: Limits, *, keep_open: Sequence[int] = ()
    ) -> list[Outcome]:
        """Run ``jobs`` into ``directory``; workers of this machine keep the descriptors ``keep_open`` open."""


@dataclass(frozen=True)
class Engine:
    """A way to work off a list of jobs."""

    run: Run
    slots: Callable[[int, Limits], int]  # of so many jobs, how many run at a time
    check: Callable[[Limits], None]  # raises `InputError` where it cannot work here; writes nothing


def run_directory(directory: Path, job: Job) -> Path:
    """Where a job's result stands in a comparison's directory."""
    return directory / JOBS / job.name
