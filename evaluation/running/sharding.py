"""Split the jobs of a comparison between several programs that write into the same directory."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.evaluation.archive.jobs import Job


@dataclass(frozen=True)
class Shard:
    """Select the jobs of program ``number`` out of ``of`` programs."""

    number: int  # from 1
    of: int

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Parse a text such as ``2/8``; raise `InputError` for any other form."""
        found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
        if not found or not 1 <= int(found[1]) <= int(found[2]):
            raise InputError(
                f"--shard is I/N with I from 1 to N, as in 2/8 for the second of eight; got {short_repr(text)}"
            )
        return cls(int(found[1]), int(found[2]))

    def part(self, jobs: Sequence[Job]) -> list[Job]:
        """Return every ``of``-th job, beginning with number ``number``."""
        return list(jobs[self.number - 1 :: self.of])

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"
