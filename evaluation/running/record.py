"""Write the record of a comparison, ``compare.json``: its jobs, commands, failed jobs and repeated attempts."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

from activestructure_gym.evaluation.archive import json_files, store
from activestructure_gym.evaluation.archive.comparison import read_record
from activestructure_gym.evaluation.archive.directory_lock import alone
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.machine import hardware as machine
from activestructure_gym.evaluation.running.engines import Listener, Outcome
from activestructure_gym.evaluation.running.episode import Progress


def new_record(
    jobs: Sequence[Job],
    before: Mapping[str, Any] | None,
    *,
    engine: str,
    slots: int,
    command: str,
    asked: Collection[str],
) -> dict[str, Any]:
    """Return the content of ``compare.json``: the first command, and under ``resumed`` those that added jobs.

    ``asked`` holds the names of the jobs of this call. The errors of other jobs that failed before are kept.
    """
    failed = {} if before is None else before.get("failed") or {}
    return {
        "format": store.FORMAT_VERSION,
        "command": before["command"] if before else command,
        "resumed": [*before.get("resumed", []), *[command] * (len(jobs) > len(before["jobs"]))] if before else [],
        "engine": engine,
        "workers": slots,
        "jobs": {job.name: job.as_dict() for job in jobs},
        "failed": {job.name: failed[job.name] for job in jobs if job.name in failed and job.name not in asked},
        "attempts": dict(before.get("attempts", {})) if before else {},
        "versions": machine.versions(),
        "hardware": machine.hardware(),
    }


def changing(directory: Path, *, shared: bool) -> AbstractContextManager[None]:
    """Return a context in which ``compare.json`` is read and written; if it is ``shared``, no other shard does so."""
    return alone(directory / f".{store.COMPARISON}.lock") if shared else nullcontext()


class Recording:
    """Forward all events to a listener, and record failed jobs and repeated attempts.

    ``shared`` says whether other programs write into the directory.
    """

    def __init__(self, listener: Listener, directory: Path, record: dict[str, Any], *, shared: bool = False) -> None:
        self._listener, self._directory, self._record, self._shared = listener, directory, record, shared
        self.failed: list[Outcome] = []

    def begin(self, jobs: Sequence[Job], finished: int) -> None:
        """See `Listener`."""
        self._listener.begin(jobs, finished)

    def progress(self, job: Job, progress: Progress) -> None:
        """See `Listener`."""
        self._listener.progress(job, progress)

    def on_retry(self, job: Job, error: str) -> None:
        """See `Listener`."""
        self._listener.on_retry(job, error)

    def ended(self, outcome: Outcome) -> None:
        """See `Listener`."""
        if not outcome.finished:
            self.failed.append(outcome)
        if not outcome.finished or outcome.attempts > 1:
            with changing(self._directory, shared=self._shared):
                record = read_record(self._directory) or self._record  # another shard may have changed it
                if not outcome.finished:
                    record.setdefault("failed", {})[outcome.job.name] = outcome.error
                if outcome.attempts > 1:
                    record.setdefault("attempts", {})[outcome.job.name] = outcome.attempts
                json_files.write_json(self._directory / store.COMPARISON, record)
        self._listener.ended(outcome)
