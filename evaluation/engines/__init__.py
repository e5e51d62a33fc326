"""How a list of jobs is worked off. An engine is a function `run(jobs, directory, listener, workers) -> outcomes`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from activestructure_gym.errors import unknown_name
from activestructure_gym.evaluation.engines.base import Listener, Outcome
from activestructure_gym.evaluation.engines.inline import run_inline
from activestructure_gym.evaluation.engines.local import run_local
from activestructure_gym.evaluation.jobs import Job

Engine = Callable[[Sequence[Job], Path, Listener, int], list[Outcome]]

ENGINES: dict[str, Engine] = {"inline": run_inline, "local": run_local}


def get_engine(name: str) -> Engine:
    """The engine called ``name``; raises `InputError` naming the nearest known one."""
    if name not in ENGINES:
        raise unknown_name("engine", name, ENGINES)
    return ENGINES[name]


__all__ = ["ENGINES", "Engine", "Listener", "Outcome", "get_engine", "run_inline", "run_local"]
