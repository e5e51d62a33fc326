"""Store the best rows of every decision of a run with their scores, terms and features, and read them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS
from activestructure_gym.evaluation.archive.schema import MAX_NUMBER, Array, Mismatch, check_arrays
from activestructure_gym.policies.scored import Scored, neutral

BEST = 5  # rows of a decision
_TERM = "term:"  # begins the names of the arrays of terms
_LAYOUT = {
    "starts": Array("i8", ("starts",), low=0, least=1),
    "rows": Array("i8", ("R",), low=0),
    "scores": Array("f8", ("R",)),
    "views": Array("f4", ("R", len(CANDIDATE_COLUMNS))),
    "features": Array("f4", ("R", "F")),
    "scored": Array("b1", ("D",)),
}


@dataclass(frozen=True)
class Row:
    """Hold one candidate of a decision.

    Attributes
    ----------
    row
        Row of the candidate table.
    score
        Score by the policy; None if the policy compared no scores.
    view
        Values of `CANDIDATE_COLUMNS` by name: position and path length in metres, view direction, frames, revisit.
    features, terms
        Features of the policy, and terms of the score as in `Scored`, by name. Terms without effect in all rows of the
        decision (0, or a factor of 1) are left out.
    """

    row: int
    score: float | None
    view: dict[str, float]
    features: dict[str, float]
    terms: dict[str, float]


class DecisionLog:
    """Collect the best rows of the decisions of an episode."""

    def __init__(self) -> None:
        self._decisions: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = []
        self._terms: list[dict[str, np.ndarray]] = []
        self._scored: list[bool] = []

    def add(self, observation: Mapping[str, np.ndarray], choice: int, comparisons: Sequence[Scored]) -> None:
        """Add a decision: the chosen row, then up to four others by descending score.

        Only the last of the policy's ``comparisons`` is stored, and only if its best row is the ``choice``.
        """
        scored = comparisons[-1] if comparisons and comparisons[-1].row == choice else None
        rows = np.array([choice], np.int64) if scored is None else best_rows(scored)
        scores = np.zeros(1) if scored is None else _finite(scored.scores[rows])
        views = observation["candidates"][rows, : len(CANDIDATE_COLUMNS)].astype(np.float32)
        self._decisions.append((rows, scores, views, _finite(observation["candidate_features"][rows])))
        self._terms.append({} if scored is None else {k: _finite(v[rows]) for k, v in scored.terms.items()})
        self._scored.append(scored is not None)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays of the file. A term that a decision lacks is 0, or 1 if it is a factor (`neutral`)."""
        counts = [len(rows) for rows, *_ in self._decisions]
        names = list(dict.fromkeys(name for terms in self._terms for name in terms))
        rows, scores, views, features = zip(*self._decisions) if self._decisions else ((), (), (), ())
        none = np.zeros(0), np.zeros((0, len(CANDIDATE_COLUMNS))), np.zeros((0, 0))
        columns = {
            f"{_TERM}{name}": [
                terms.get(name, np.full(count, neutral(name))) for terms, count in zip(self._terms, counts)
            ]
            for name in names
        }
        return {
            "starts": np.cumsum([0, *counts]).astype(np.int64),
            "rows": np.concatenate(rows or none[:1]).astype(np.int64),
            "scores": np.concatenate(scores or none[:1]).astype(np.float64),
            "views": np.concatenate(views or none[1:2]).astype(np.float32),
            "features": np.concatenate(features or none[2:]).astype(np.float32),
            "scored": np.array(self._scored, bool),
            **{name: np.concatenate(parts).astype(np.float64) for name, parts in columns.items()},
        }


def best_rows(scored: Scored) -> np.ndarray:
    """Return the chosen row, then the rows with the highest other scores, at most `BEST` rows in all."""
    order = np.argsort(-scored.scores, kind="stable")
    others = order[(scored.scores[order] > -np.inf) & (order != scored.row)]
    return np.array([scored.row, *others[: BEST - 1]], np.int64)


def rows_by_decision(arrays: Mapping[str, np.ndarray], features: Sequence[str]) -> list[list[Row]]:
    """Return the rows of every decision, the chosen one first.

    ``features`` are the names of the feature columns. Raise `Mismatch` unless the arrays agree with each other and with
    the names, and each decision has at least one row and at most `BEST`.
    """
    terms = {name.removeprefix(_TERM): name for name in arrays if name.startswith(_TERM)}
    sizes = check_arrays(arrays, {**_LAYOUT, **dict.fromkeys(terms.values(), Array("f8", ("R",)))})
    starts, scored = arrays["starts"], arrays["scored"]
    counts = np.diff(starts)
    if len(counts) != sizes["D"] or starts[0] != 0 or starts[-1] != sizes["R"]:
        raise Mismatch("starts does not fit the rows")
    if ((counts < 1) | (counts > BEST)).any():
        raise Mismatch(f"each decision must have 1 to {BEST} rows")
    if sizes["F"] != len(features) and sizes["R"]:
        raise Mismatch(f"it holds {sizes['F']} features, but config.json names {len(features)}")
    decisions = []
    for decision in range(sizes["D"]):
        first, end = starts[decision : decision + 2]
        own = {
            name: arrays[array] for name, array in terms.items() if (arrays[array][first:end] != neutral(name)).any()
        }
        decisions.append([
            Row(
                row=int(arrays["rows"][at]),
                score=float(arrays["scores"][at]) if scored[decision] else None,
                view=_named(CANDIDATE_COLUMNS, arrays["views"][at]),
                features=_named(features, arrays["features"][at]),
                terms={name: float(values[at]) for name, values in own.items()},
            )
            for at in range(first, end)
        ])  # fmt: skip
    return decisions


def _named(names: Sequence[str], values: np.ndarray) -> dict[str, float]:
    return dict(zip(names, map(float, values)))


def _finite(values: np.ndarray) -> np.ndarray:
    """Return the values within the limits of a stored number; NaN becomes 0."""
    return np.nan_to_num(np.asarray(values, np.float64), posinf=MAX_NUMBER, neginf=-MAX_NUMBER).clip(
        -MAX_NUMBER, MAX_NUMBER
    )
