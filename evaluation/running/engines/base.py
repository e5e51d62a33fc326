"""The interface of engines: limits, listener, outcomes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.running.episode import Progress
from activestructure_gym.ranges import check_ranges

LOGS = "logs"  # sub-directory of a comparison: what the workers wrote to standard error
_RANGES = {"workers": "[0, 4096]", "timeout_min": "[0, 525600]", "retries": "[0, 1000]"}  # a timeout of up to a year


@dataclass(frozen=True)
class Limits:
    """Limits of a comparison: jobs at a time, minutes per attempt, further attempts."""

    workers: int = 0  # jobs at a time; 0 = as many as there are cores
    timeout_min: float = 0.0  # minutes per attempt at a job; 0 = any time
    retries: int = 1  # further attempts at a job that was killed or ran out of time

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES, "--")


@dataclass(frozen=True)
class Outcome:
    """The end of a job: finished, or the error."""

    job: Job
    error: str | None = None  # None: finished, and its run directory is whole
    attempts: int = 1

    @property
    def finished(self) -> bool:
        """Whether there is a result."""
        return self.error is None


class Listener(Protocol):
    """Callbacks while jobs run, all from one thread."""

    def begin(self, jobs: Sequence[Job], finished: int) -> None:
        """These jobs will run; so many more were finished before."""

    def progress(self, job: Job, progress: Progress) -> None:
        """A running job got somewhere."""

    def on_retry(self, job: Job, error: str) -> None:
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
