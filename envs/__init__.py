"""Provide the Gymnasium environments: spaces, observation, reward, rendering and registration.

Importing this package is fast: numba and torch are loaded when an environment is first used.

>>> import gymnasium as gym
>>> from activestructure_gym.envs import ENV_IDS
>>> ENV_IDS[0]
'ActiveStructure/Room-v0'
>>> env = gym.make(ENV_IDS[0], scene="box", preset="fast", render_mode="rgb_array")
>>> env.action_space, env.observation_space["candidates"].shape
(Discrete(64), (64, 9))
>>> env.close()
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from activestructure_gym.envs.registration import ENV_IDS, register_envs

if TYPE_CHECKING:
    from activestructure_gym.envs.reconstruction_env import ReconstructionEnv
    from activestructure_gym.envs.reward import RewardConfig
    from activestructure_gym.envs.tasks import ApartmentEnv, Matterport3DEnv, MeshEnv, ReplicaEnv, RoomEnv, WorldEnv

_PLACES = {
    "reconstruction_env": ("ReconstructionEnv",),
    "reward": ("RewardConfig",),
    "tasks": ("ApartmentEnv", "Matterport3DEnv", "MeshEnv", "ReplicaEnv", "RoomEnv", "WorldEnv"),
}
_MODULE_OF = {name: f"{__name__}.{module}" for module, names in _PLACES.items() for name in names}

__all__ = [
    "ENV_IDS",
    "ApartmentEnv",
    "Matterport3DEnv",
    "MeshEnv",
    "ReconstructionEnv",
    "ReplicaEnv",
    "RewardConfig",
    "RoomEnv",
    "WorldEnv",
    "register_envs",
]


def __getattr__(name: str) -> Any:
    if name in _MODULE_OF:
        return getattr(import_module(_MODULE_OF[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
