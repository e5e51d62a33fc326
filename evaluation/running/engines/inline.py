"""Run jobs one after the other in this process, for debugging or a single core."""

from __future__ import annotations

import traceback
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.comparison import run_directory
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.archive.temporary import unlinked
from activestructure_gym.evaluation.running.engines.base import LOGS, Engine, Limits, Listener, Outcome
from activestructure_gym.evaluation.running.engines.failure_text import error_text
from activestructure_gym.evaluation.running.episode import run_job


def run_inline(
    jobs: Sequence[Job], directory: Path, listener: Listener, limits: Limits, *, keep_open: Sequence[int] = ()
) -> list[Outcome]:
    """Run all jobs. A failed job is reported and the others continue; a crash of the process ends the comparison."""
    outcomes = []
    for job in jobs:
        outcome = Outcome(job)
        try:
            run_job(job, run_directory(directory, job), partial(listener.progress, job))
        except (Exception, SystemExit) as error:  # a plug-in policy may raise any exception
            log = directory / LOGS / f"{job.name}.log"
            log.parent.mkdir(parents=True, exist_ok=True)
            unlinked(log).write_text(traceback.format_exc(), encoding="utf-8")
            outcome = Outcome(job, error_text(error))
        listener.ended(outcome)
        outcomes.append(outcome)
    return outcomes


def _check(limits: Limits) -> None:
    if limits.timeout_min:
        raise InputError("engine 'inline' cannot stop a run; give --timeout-min with engine 'local'")


ENGINE = Engine(run_inline, slots=lambda jobs, limits: 1, check=_check)
