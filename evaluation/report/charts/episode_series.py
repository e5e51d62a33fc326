"""Extract time series of an episode from its decisions: phases, Plane Scene Graph, and scores of the chosen views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

Steps = Sequence[Mapping[str, Any]]  # lines of steps.jsonl, one per decision

SETTLED = "settled"  # name of the phase that follows a policy's last phase once that has finished
_MAX_DRAWN = 2000  # largest number of decisions in a chart; of more decisions, every n-th one is drawn


@dataclass(frozen=True)
class Band:
    """Hold an interval of frames in which a policy is in one phase."""

    phase: str
    start: float  # frames taken at the beginning
    end: float  # frames taken at the end
    reason: str | None = None  # why the policy changed to this phase


def bands(steps: Steps) -> list[Band]:
    """Return the intervals of an episode's phases in order; empty for a policy without phases.

    Decisions with an entry ``settled`` in their trace form the phase `SETTLED`.
    """
    found: list[Band] = []
    for step, start in zip(steps, starts(steps)):
        trace = step.get("trace") or {}
        phase, reason = trace.get("phase"), trace.get("changed")
        if phase is None:
            continue
        if settled := trace.get("settled"):
            phase, reason = SETTLED, settled if isinstance(settled, str) else None
        if found and found[-1].phase == phase and found[-1].end == start:
            found[-1] = replace(found[-1], end=step["frames"])
        else:
            found.append(Band(str(phase), start, step["frames"], reason))
    return found


def drawn_decisions(count: int) -> list[int]:
    """Return the indices of the decisions to draw out of ``count``: all, or every n-th one and the last one."""
    every = -(-count // _MAX_DRAWN) or 1
    return sorted({*range(0, count, every), *range(max(count - 1, 0), count)})


def drawn_steps(steps: Steps) -> Steps:
    """Return the steps of the decisions that `drawn_decisions` selects."""
    return [steps[number] for number in drawn_decisions(len(steps))]


def chosen_terms(steps: Steps) -> dict[str, np.ndarray]:  # [T] each, NaN if a decision lacks it
    """Return the terms and factors of the score of the chosen view at each of T decisions, by name.

    They are in the entry ``chosen`` of a decision's trace, or without such an entry in the trace itself.
    """
    traces = [step.get("trace") or {} for step in steps]
    rows = [
        {name: value for name, value in (trace.get("chosen") or trace).items() if isinstance(value, float)}
        for trace in traces
    ]
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: np.array([row.get(name, np.nan) for row in rows]) for name in names}


def starts(steps: Steps) -> list[float]:
    """Return the number of frames taken before each decision; it is 1 before the first decision."""
    return [1, *(step["frames"] for step in steps[:-1])][: len(steps)]


def graph_series(steps: Steps, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the frames [T] taken and the field ``name`` [T] of the Plane Scene Graph at the end of each decision.

    The value is NaN where the field is missing.
    """
    values = [(step.get("graph") or {}).get(name) for step in steps]
    frames = np.array([step["frames"] for step in steps], float)
    return frames, np.array([np.nan if value is None else value for value in values], float)
