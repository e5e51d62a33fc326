"""Define the interface of engines: limits, listener and outcomes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.running.episode import Progress
from activestructure_gym.ranges import check_ranges

LOGS = "logs"  # sub-directory of a comparison with the standard error of the workers
_RANGES = {"workers": "[0, 4096]", "timeout_min": "[0, 525600]", "retries": "[0, 1000]"}  # 525600 min = 1 year


@dataclass(frozen=True)
class Limits:
    """Limit the jobs at a time, the time per attempt, and the number of attempts.

    Parameters
    ----------
    workers
        Jobs at a time; 0 = number of cores.
    timeout_min
        Minutes per attempt at a job; 0 = no limit.
    retries
        Further attempts at a job that was killed or exceeded the time limit.
    """

    workers: int = 0
    timeout_min: float = 0.0
    retries: int = 1

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES, "--")


@dataclass(frozen=True)
class Outcome:
    """Hold the outcome of a job: finished, or the error."""

    job: Job
    error: str | None = None  # None: finished, with a complete run directory
    attempts: int = 1

    @property
    def finished(self) -> bool:
        """Return whether the job has a result."""
        return self.error is None


class Listener(Protocol):
    """Receive callbacks while jobs run, all from one thread."""

    def begin(self, jobs: Sequence[Job], finished: int) -> None:
        """Receive the jobs to run, once before the first one. ``finished``: jobs skipped because results exist."""

    def progress(self, job: Job, progress: Progress) -> None:
        """Receive the progress of a running job."""

    def on_retry(self, job: Job, error: str) -> None:
        """Receive the error of a failed attempt; another attempt follows."""

    def ended(self, outcome: Outcome) -> None:
        """Receive the outcome of a job, finished or failed."""


class Run(Protocol):
    """Define the function of an engine that runs a list of jobs."""

    def __call__(
        self, jobs: Sequence[Job], directory: Path, listener: Listener, limits: Limits, *, keep_open: Sequence[int] = ()
    ) -> list[Outcome]:
        """Run ``jobs`` into ``directory``; workers of this machine keep the descriptors ``keep_open`` open."""


@dataclass(frozen=True)
class Engine:
    """Describe a way to run a list of jobs."""

    run: Run
    slots: Callable[[int, Limits], int]  # number of jobs -> jobs at a time
    check: Callable[[Limits], None]  # raises `InputError` if the engine cannot work here; writes nothing
