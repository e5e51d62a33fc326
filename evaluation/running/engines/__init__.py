"""Engines, which run a list of jobs: in this process, in processes of this machine, or on a cluster."""

from __future__ import annotations

from activestructure_gym.errors import unknown_name
from activestructure_gym.evaluation.running.engines import inline, local, ray_cluster
from activestructure_gym.evaluation.running.engines.base import Engine, Limits, Listener, Outcome

# Anybody may add an engine of their own, so their names are any text.
ENGINES: dict[str, Engine] = {"inline": inline.ENGINE, "local": local.ENGINE, "ray": ray_cluster.ENGINE}


def get_engine(name: str) -> Engine:
    """The engine called ``name``; raises `InputError` naming the nearest known one."""
    if name not in ENGINES:
        raise unknown_name("engine", name, ENGINES)
    return ENGINES[name]


__all__ = ["ENGINES", "Engine", "Limits", "Listener", "Outcome", "get_engine"]
