"""Extract series of an episode: phases, state of the Plane Scene Graph, terms and factors of chosen views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

Steps = Sequence[Mapping[str, Any]]  # the lines of steps.jsonl

SETTLED = "settled"  # name of the phase after the last one has finished
_MAX_DRAWN = 2000  # decisions in a chart; of more, an even selection, since a chart has fewer pixels


@dataclass(frozen=True)
class Band:
    """Hold an interval of frames with the same phase."""

    phase: str
    start: float  # frames
    end: float
    reason: str | None = None  # for the change to this phase


def bands(steps: Steps) -> list[Band]:
    """Return the phases of an episode; empty without phases.

    Decisions whose trace contains ``settled`` form a further phase.
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
    """Return the numbers of the decisions to show: all, or an even selection that includes the last one."""
    every = -(-count // _MAX_DRAWN) or 1
    return sorted({*range(0, count, every), *range(max(count - 1, 0), count)})


def drawn_steps(steps: Steps) -> Steps:
    """Return the decisions that `drawn_decisions` selects."""
    return [steps[number] for number in drawn_decisions(len(steps))]


def chosen_terms(steps: Steps) -> dict[str, np.ndarray]:  # [T] each, NaN if a decision lacks it
    """Return the terms and factors of each chosen view: those in the trace's ``chosen``, else those of the trace."""
    traces = [step.get("trace") or {} for step in steps]
    rows = [
        {name: value for name, value in (trace.get("chosen") or trace).items() if isinstance(value, float)}
        for trace in traces
    ]
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: np.array([row.get(name, np.nan) for row in rows]) for name in names}


def starts(steps: Steps) -> list[float]:
    """Return the frames used before each decision; the first frame precedes all decisions."""
    return [1, *(step["frames"] for step in steps[:-1])][: len(steps)]


def graph_series(steps: Steps, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return frames [T] and values [T] of a field of the graph at the end of each decision; NaN if it is missing."""
    values = [(step.get("graph") or {}).get(name) for step in steps]
    frames = np.array([step["frames"] for step in steps], float)
    return frames, np.array([np.nan if value is None else value for value in values], float)
