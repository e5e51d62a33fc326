"""What every engine reports."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from activestructure_gym.evaluation.episode import Progress
from activestructure_gym.evaluation.jobs import Job

JOBS = "jobs"  # sub-directory of a comparison: one run directory per finished job
LOGS = "logs"  # sub-directory of a comparison: what the workers wrote to standard error


@dataclass(frozen=True)
class Outcome:
    """How a job ended."""

    job: Job
    error: str | None = None  # None: finished, and its run directory is whole

    @property
    def finished(self) -> bool:
        """Whether there is a result."""
        return self.error is None


class Listener(Protocol):
    """Who is told what happens while jobs run. Called from one thread."""

    def progress(self, job: Job, progress: Progress) -> None:
        """A running job got somewhere."""

    def ended(self, outcome: Outcome) -> None:
        """A job ended, one way or the other."""


def run_directory(directory: Path, job: Job) -> Path:
    """Where a job's result stands in a comparison's directory."""
    return directory / JOBS / job.name
