"""Who works on which job, where several programs share a comparison's directory and nothing else.

A claim is a file, ``claims/<job>.<turn>``, that only one program can create. While its owner lives he gives it a new
time every few seconds; one that grows old is lost, and whoever creates the file of the next turn has the job. Time is
that of the file system, so that clocks of machines may differ. Two owners, as where a machine slept, do no harm: equal
jobs give equal results, which are put into their place at once.
"""

from __future__ import annotations

import glob
import json
import math
import os
import secrets
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import temporary
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.machine.processes import machine_mark

CLAIMS = "claims"  # in a comparison's directory
LOST_AFTER = "ASG_LOST_AFTER"  # variable: seconds without a sign of life
_USUAL_LOST_AFTER = 120.0
_BEATS = 6  # signs of life in that time
_FAILED = ".failed"


class Claims:
    """The claims of this program in a comparison's directory."""

    def __init__(self, directory: Path) -> None:
        self.lost_after = _lost_after()
        self._place = directory / CLAIMS
        temporary.refuse_links(directory, CLAIMS)
        with temporary.writing(self._place):
            self._place.mkdir(parents=True, exist_ok=True)
        # Containers may share their name and the numbers of their processes.
        self._who = f"{machine_mark()}-{os.getpid()}-{secrets.token_hex(4)}"
        self._held: dict[str, Path] = {}  # by the job's name
        self._guard = threading.Lock()

    def take(self, jobs: Sequence[Job], most: int) -> list[Job]:
        """The first jobs, at most so many, that nobody else works on; they are this program's from now on."""
        mine = list[Job]()
        for job in jobs:
            if len(mine) == most:
                break
            if self._take(job.name):
                mine.append(job)
        return mine

    def release(self, job: Job) -> None:
        """Give a job back, done or not."""
        with self._guard:
            path = self._held.pop(job.name, None)
        if path is not None:
            for turn in range(int(path.suffix[1:]) + 1):  # those of lost owners, too
                path.with_suffix(f".{turn}").unlink(missing_ok=True)

    def fail(self, job: Job, error: str) -> None:
        """Let nobody else begin with a job that failed here."""
        path = self._place / f"{job.name}{_FAILED}"
        with suppress(FileExistsError), open(path, "x", encoding="utf-8") as file:
            file.write(error)

    def failure(self, job: Job) -> str | None:
        """Why a job failed, here or elsewhere; None if it did not."""
        try:
            return (self._place / f"{job.name}{_FAILED}").read_text(encoding="utf-8")
        except OSError:
            return None

    def forgive(self) -> None:
        """Let failed jobs be tried again."""
        for path in self._place.glob(f"*{_FAILED}"):
            path.unlink(missing_ok=True)

    def first(self, what: str) -> bool:
        """Whether this program is the first one to ask for something that only one should do."""
        with suppress(FileExistsError):
            os.close(os.open(self._place / f".{what}", os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
            return True
        return False

    @contextmanager
    def alive(self) -> Iterator[None]:
        """Give signs of life for all that is held while the block runs; give everything back at its end."""
        stop = threading.Event()

        def beat() -> None:
            while not stop.wait(self.lost_after / _BEATS):
                with self._guard:
                    held = list(self._held.values())
                for path in held:
                    with suppress(OSError):  # given back meanwhile; a file system that does not answer
                        os.utime(path)

        thread = threading.Thread(target=beat, name="claims", daemon=True)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()
            for path in self._held.values():
                path.unlink(missing_ok=True)
            self._held.clear()

    def _take(self, name: str) -> bool:
        endings = (path.name.rpartition(".")[2] for path in self._place.glob(f"{glob.escape(name)}.*"))
        turn = max((int(ending) for ending in endings if ending.isdigit()), default=-1)
        if turn >= 0 and not self._is_lost(self._place / f"{name}.{turn}"):
            return False
        path = self._place / f"{name}.{turn + 1}"
        try:
            with open(path, "x", encoding="utf-8") as file:
                json.dump({"who": self._who}, file)
        except FileExistsError:
            return False  # somebody was faster
        with self._guard:
            self._held[name] = path
        return True

    def _is_lost(self, path: Path) -> bool:
        probe = self._place / f".now-{self._who}"
        try:
            probe.touch()
            return probe.stat().st_mtime - path.stat().st_mtime > self.lost_after
        except FileNotFoundError:
            return False  # given back this moment
        finally:
            probe.unlink(missing_ok=True)


def _lost_after() -> float:
    given = os.environ.get(LOST_AFTER, "")
    try:
        seconds = float(given) if given else _USUAL_LOST_AFTER
    except ValueError:
        seconds = math.nan
    if not 0.0 < seconds < math.inf:
        raise InputError(f"{LOST_AFTER} is a number of seconds above 0, got '{given}'")
    return seconds


def failures(directory: Path) -> dict[str, str]:  # by the job's name
    """Why jobs failed in a comparison's directory that several programs work on; none without such a directory."""
    found = {}
    for path in sorted((directory / CLAIMS).glob(f"*{_FAILED}")):
        with suppress(OSError):
            found[path.name.removesuffix(_FAILED)] = path.read_text(encoding="utf-8", errors="replace")
    return found
