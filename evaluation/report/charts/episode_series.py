"""Series of an episode's timeline: phases, state of the Plane Scene Graph, terms and factors of chosen views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

Steps = Sequence[Mapping[str, Any]]  # the lines of steps.jsonl

SETTLED = "settled"  # the band of what is decided once nothing is left for the last phase to do
_MAX_DRAWN = 2000  # decisions of an episode; of more, an even choice: the picture has fewer pixels


@dataclass(frozen=True)
class Band:
    """Decisions in a row with the same phase."""

    phase: str
    start: float  # frames
    end: float
    reason: str | None = None  # why it began


def bands(steps: Steps) -> list[Band]:
    """The phases of an episode, what follows once its trace says ``settled`` as one more; empty without phases."""
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
    """Return the numbers of the decisions that are shown: all, or an even choice of them with the last one."""
    every = -(-count // _MAX_DRAWN) or 1
    return sorted({*range(0, count, every), *range(max(count - 1, 0), count)})


def drawn_steps(steps: Steps) -> Steps:
    """Return the decisions of `drawn_decisions`."""
    return [steps[number] for number in drawn_decisions(len(steps))]


def chosen_terms(steps: Steps) -> dict[str, np.ndarray]:  # [T] each, nan where a decision has no such number
    """The numbers behind every chosen view: the trace's ``chosen``, or those of a trace without one."""
    traces = [step.get("trace") or {} for step in steps]
    rows = [
        {name: value for name, value in (trace.get("chosen") or trace).items() if isinstance(value, float)}
        for trace in traces
    ]
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: np.array([row.get(name, np.nan) for row in rows]) for name in names}


def starts(steps: Steps) -> list[float]:
    """Frames paid when each decision was made; the first frame belongs to none."""
    return [1, *(step["frames"] for step in steps[:-1])][: len(steps)]


def graph_series(steps: Steps, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Frames and values of one number of the graph at the end of each decision; nan, a gap, where there was none."""
    values = [(step.get("graph") or {}).get(name) for step in steps]
    frames = np.array([step["frames"] for step in steps], float)
    return frames, np.array([np.nan if value is None else value for value in values], float)
