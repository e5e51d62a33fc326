"""Record the scores by which a policy compares the candidates, so that its decisions can be explained."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field

import numpy as np

from activestructure_gym.errors import InputError, short_repr

FACTOR = "× "  # begins the name of a term that multiplies the sum of the others


def neutral(term: str) -> float:
    """Return the value of a term that has no effect on a score: 1 for a factor, else 0."""
    return float(term.startswith(FACTOR))


@dataclass(frozen=True)
class Scored:
    """Hold one comparison of K candidates.

    Attributes
    ----------
    row
        The row with the best score.
    scores
        [K] scores; -inf in rows that were not compared.
    terms
        Terms of the scores by name, [K] each. A score is the sum of the terms, times those that begin with `FACTOR`.
    """

    row: int
    scores: np.ndarray
    terms: Mapping[str, np.ndarray] = field(default_factory=dict)


_RECORD: ContextVar[list[Scored] | None] = ContextVar("record", default=None)


@contextmanager
def recorded_scores() -> Iterator[list[Scored]]:
    """Yield a list that receives every comparison made in the block, in order."""
    record: list[Scored] = []
    token = _RECORD.set(record)
    try:
        yield record
    finally:
        _RECORD.reset(token)


def first_best(rows: np.ndarray, scores: np.ndarray) -> int:
    """Return the first of ``rows`` [n] with the highest of ``scores`` [K], and record the comparison."""
    row = int(rows[np.argmax(scores[rows])])
    compared = np.full(len(scores), -np.inf)
    compared[rows] = scores[rows]
    record_scores(row, compared)
    return row


def record_scores(row: int, scores: np.ndarray, terms: Mapping[str, np.ndarray] | None = None) -> None:
    """Append a comparison to the list of the innermost `recorded_scores`, if there is one.

    Raises `InputError` unless ``terms`` is a mapping and every term has one number per row.
    """
    if terms is not None and not isinstance(terms, Mapping):
        raise InputError(f"terms must be a dict of arrays by name, got {short_repr(terms)}")
    copies = {name: np.array(term, np.float64) for name, term in (terms or {}).items()}
    for name, term in copies.items():
        if term.shape != scores.shape:
            raise InputError(f"term '{name}' must have one number per row, {scores.shape}, got {term.shape}")
    record = _RECORD.get()
    if record is not None:
        record.append(Scored(row, scores, copies))
