"""The Gymnasium face of the reconstruction: spaces, observation, reward, rendering, registration.

Light to import: `ReconstructionEnv` and the tasks load what they need (numba, embree, torch) on first use.
"""

from typing import Any

from activestructure_gym.envs.registration import ENV_IDS, register_envs

__all__ = ["ENV_IDS", "ReconstructionEnv", "register_envs"]


def __getattr__(name: str) -> Any:
    if name == "ReconstructionEnv":
        from activestructure_gym.envs.reconstruction_env import ReconstructionEnv

        return ReconstructionEnv
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
