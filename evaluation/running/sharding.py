"""One of several programs that work off the same comparison and share nothing but its directory.

Each begins with its own share of the jobs and then helps with the others'; claims see to it that no two work on the
same one, and that the jobs of one that was lost are taken over.
"""

from __future__ import annotations

import hashlib
import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from activestructure_gym.errors import InputError, shown
from activestructure_gym.evaluation.archive import store
from activestructure_gym.evaluation.archive.claims import Claims
from activestructure_gym.evaluation.archive.comparison import finished_runs, read_record, run_directory
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.running.comparison import Result, new_record
from activestructure_gym.evaluation.running.engines import Limits, Listener, Outcome, get_engine
from activestructure_gym.evaluation.running.resuming import merged, recorded_jobs, settle

_LOOK = 2.0  # seconds between two looks at what the others have done


@dataclass(frozen=True)
class Shard:
    """Which of how many programs this one is."""

    number: int  # from 1 on
    of: int

    @classmethod
    def parse(cls, text: str) -> Shard:
        """``2/8``; raises `InputError` for anything else."""
        found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
        if not found or not 1 <= int(found[1]) <= int(found[2]):
            raise InputError(f"--shard is a number of how many, from 1/N to N/N, as in 2/8; got {shown(text)}")
        return cls(int(found[1]), int(found[2]))

    def order(self, jobs: Sequence[Job]) -> list[Job]:
        """This one's share first, then the others' from the next one on, so that helpers begin at different places."""
        shares = [jobs[(self.number - 1 + step) % self.of :: self.of] for step in range(self.of)]
        return [job for share in shares for job in share]


def run_shard(
    jobs: Sequence[Job],
    directory: Path,
    listener: Listener,
    shard: Shard,
    *,
    engine: str = "local",
    limits: Limits | None = None,
    again: bool = False,  # whether what failed before is tried again
    command: str = "",
    held: int | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> tuple[Result, bool]:
    """Work off ``jobs`` together with others, until all of them are finished or failed.

    As `run_comparison` for all else. Returns the result, and whether this program is the one to report it: the others
    have it, too, and one report is enough.
    """
    chosen, limits = get_engine(engine), limits or Limits()
    everything = merged(recorded_jobs(directory), jobs, directory)
    claims = Claims(directory)
    if again:
        claims.forgive()
    before = read_record(directory)
    if before is None or set(before["jobs"]) != {job.name for job in everything}:
        slots = chosen.slots(len(jobs), limits)
        store.write_json(
            directory / store.COMPARISON, new_record(everything, before, engine=engine, slots=slots, command=command)
        )
    settle(everything, {job.name for job in jobs} if again else (), directory, tell)

    def left() -> list[Job]:
        return [job for job in waiting if not _is_done(job) and claims.failure(job) is None]

    def _is_done(job: Job) -> bool:
        return store.is_done(run_directory(directory, job), job)

    order = shard.order(jobs)
    waiting = [job for job in order if not _is_done(job)]
    skipped = len(jobs) - len(waiting)
    listener.begin(waiting, skipped)
    told = set[str]()
    heard = _Heard(listener)
    with claims.alive():
        while open_jobs := left():
            mine = claims.take(open_jobs, chosen.slots(len(open_jobs), limits))
            ready = [job for job in mine if not _is_done(job)]  # it may have ended between two looks
            if ready:
                chosen.run(ready, directory, heard, limits, keep_open=() if held is None else (held,))
            for outcome in heard.take():
                told.add(outcome.job.name)
                if not outcome.finished:
                    claims.fail(outcome.job, outcome.error or "")
            for job in mine:
                claims.release(job)
            _tell_others(waiting, told, _is_done, claims, listener)
            if not mine:
                time.sleep(min(_LOOK, claims.lost_after / 2))
        _tell_others(waiting, told, _is_done, claims, listener)
        lost = {job.name: claims.failure(job) for job in jobs if not _is_done(job)}
        failed = [Outcome(job, error) for job in jobs if (error := lost.get(job.name)) is not None]
        # A later sitting may mend what failed, or play again what other own code played.
        ended = sorted(f"{job.name} {store.mark_of(run_directory(directory, job))}" for job in everything)
        reports = claims.first(f"report-{hashlib.sha256(chr(10).join(ended).encode()).hexdigest()[:12]}")
    asked = {job.name for job in jobs}
    missing = [job for job in everything if job.name not in asked and not _is_done(job)]
    return Result(finished_runs(directory, everything), failed, skipped, len(missing)), reports


def _tell_others(
    jobs: Sequence[Job], told: set[str], is_done: Callable[[Job], bool], claims: Claims, listener: Listener
) -> None:
    """Say what ended elsewhere meanwhile."""
    for job in jobs:
        if job.name not in told and (is_done(job) or claims.failure(job) is not None):
            told.add(job.name)
            listener.ended(Outcome(job, None if is_done(job) else f"elsewhere: {claims.failure(job)}"))


class _Heard:
    """Passes everything on and keeps what ended."""

    def __init__(self, listener: Listener) -> None:
        self._outcomes: list[Outcome] = []
        self.begin, self.progress, self.on_retry = listener.begin, listener.progress, listener.on_retry
        self._listener = listener

    def ended(self, outcome: Outcome) -> None:
        """See `Listener`."""
        self._outcomes.append(outcome)
        self._listener.ended(outcome)

    def take(self) -> list[Outcome]:
        """What ended since this was asked."""
        outcomes, self._outcomes = self._outcomes, []
        return outcomes
