"""One of several programs that run one comparison into the same directory: a plain partition of its jobs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.evaluation.archive.jobs import Job


@dataclass(frozen=True)
class Shard:
    """One of ``of`` programs."""

    number: int  # from 1 on
    of: int

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Read ``2/8``; raises `InputError` for anything else."""
        found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
        if not found or not 1 <= int(found[1]) <= int(found[2]):
            raise InputError(
                f"--shard is I/N with I from 1 to N, as in 2/8 for the second of eight; got {short_repr(text)}"
            )
        return cls(int(found[1]), int(found[2]))

    def part(self, jobs: Sequence[Job]) -> list[Job]:
        """Return every ``of``-th job, from the ``number``-th one on."""
        return list(jobs[self.number - 1 :: self.of])

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"
