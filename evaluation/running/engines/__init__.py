"""Define the engines that run a list of jobs: in this process, in processes of this machine, or on a cluster."""

from __future__ import annotations

from activestructure_gym.evaluation.running.engines import inline, local, ray_cluster
from activestructure_gym.evaluation.running.engines.base import Engine, Limits, Listener, Outcome
from activestructure_gym.registry import Registry

ENGINES: Registry[Engine] = Registry(
    "engine", "engines", fits=lambda entry: isinstance(entry, Engine), wanted="an Engine"
)
ENGINES.register("inline")(inline.ENGINE)
ENGINES.register("local")(local.ENGINE)
ENGINES.register("ray")(ray_cluster.ENGINE)

__all__ = ["ENGINES", "Engine", "Limits", "Listener", "Outcome"]
