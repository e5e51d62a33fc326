"""Explain why a policy chose a view, by the scores, terms and features of the best rows of a decision."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from activestructure_gym.evaluation.archive.decisions import Row
from activestructure_gym.policies.scored import FACTOR, neutral

_MOST_FEATURES = 4  # features shown of each row
_TRAVEL = "lower travel cost, a factor"  # the factor falls with the cost of the path
_CLOSE = 1e-5  # relative difference up to which the terms reproduce a score: rounding of 32-bit features


def reason(policy: str, rows: Sequence[Row]) -> str:
    """Return one or two sentences on the choice of the first of ``rows``; ``policy`` is the name of the policy."""
    chosen, runner_up = rows[0], rows[1] if len(rows) > 1 else None
    if not any(chosen.view.values()):
        return f"{policy} chose row {chosen.row}, which holds no candidate: the camera did not move."
    if chosen.score is None:
        return f"{policy} chose this view without comparing scores."
    if runner_up is None or runner_up.score is None:
        return f"{policy} compared this view with no other."
    if chosen.score <= runner_up.score:
        return f"Two views have the best score, {short(chosen.score)}. The path or the order of the rows decided."
    scores = f"the best score, {short(chosen.score)}; the runner-up has {short(runner_up.score)}"
    leads = _leads(chosen, runner_up)
    name = max(leads, key=leads.__getitem__, default="")
    if leads.get(name, 0.0) <= 0.0:
        return f"Chosen for {scores}."
    values = f"{_TRAVEL if name == f'{FACTOR}travel' else name.removeprefix(FACTOR)} of {short(chosen.terms[name])}"
    other = short(runner_up.terms[name])
    if leads[name] >= chosen.score - runner_up.score:
        return f"Chosen for its {values}; the runner-up has {other}."
    return f"Chosen for {scores}. It leads most by its {values} against {other}."


def compared(rows: Sequence[Row]) -> list[list[str]]:
    """Return a table of the chosen row and of the runner-up: lines of a name and one or two values.

    The lines are score, terms, path and frames. Terms without effect in both rows (0, or a factor of 1) are left
    out. Features take the place of missing terms; of many features, equal ones are left out.
    """
    pair = rows[:2]
    lines = [] if pair[0].score is None else [["score", *(short(row.score) for row in pair)]]
    effective = [name for name in pair[0].terms if {row.terms[name] for row in pair} != {neutral(name)}]
    names = effective if pair[0].terms else _shown_features(pair)
    lines += [[name, *(short({**row.features, **row.terms}[name]) for row in pair)] for name in names]
    lines.append(["path", *(f"{row.view['path_length']:.2f} m" for row in pair)])
    lines.append(["frames", *(f"{row.view['frames']:.0f}" for row in pair)])
    return lines


def short(value: Any) -> str:
    """Return a number with four significant digits; other values as text."""
    return f"{value + 0.0:.4g}".replace("-", "−") if isinstance(value, float) else str(value)  # + 0.0: no "−0"


def _leads(chosen: Row, runner_up: Row) -> dict[str, float]:
    """Return the increase of the chosen row's score by each term, compared with the runner-up's value of the term.

    The result is empty if the terms do not reproduce both scores.
    """
    for row in (chosen, runner_up):
        assert row.score is not None
        if not row.terms or not math.isclose(combined(row.terms), row.score, rel_tol=_CLOSE):
            return {}
    total = combined(chosen.terms)
    return {
        name: total - combined({**chosen.terms, name: runner_up.terms[name]})
        for name, value in chosen.terms.items()
        if value != runner_up.terms[name]
    }


def combined(terms: Mapping[str, float]) -> float:
    """Return the sum of the terms times the factors; 1 times the factors if there are only factors."""
    summands = [value for name, value in terms.items() if not name.startswith(FACTOR)]
    factors = [value for name, value in terms.items() if name.startswith(FACTOR)]
    return (math.fsum(summands) if summands else 1.0) * math.prod(factors)


def _shown_features(pair: Sequence[Row]) -> list[str]:
    names = list(pair[0].features)
    if len(names) > _MOST_FEATURES:
        names = [name for name in names if len({row.features[name] for row in pair}) > 1] or names
    return names[:_MOST_FEATURES]
