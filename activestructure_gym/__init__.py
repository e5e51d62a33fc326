"""ActiveStructure Gym: Gymnasium environments and planners for active 3D reconstruction with Gaussian maps.

Importing the package registers the environments ``ActiveStructure/Room-v0``, ``Apartment-v0``, ``Mesh-v0``,
``Replica-v0``, ``Matterport3D-v0`` and ``World-v0``. A call like
``gymnasium.make("activestructure_gym:ActiveStructure/Room-v0")`` registers and makes one at once, also in worker
processes. Submodules are imported on first use.

>>> import activestructure_gym as asg
>>> env, policy = asg.make_env_and_policy("hole_area", "box", preset="fast", frame_budget=20)
>>> observation, info = env.reset(seed=0)
>>> observation, reward, terminated, truncated, info = env.step(policy.act(observation))
>>> 0 < info["frames"] <= 20
True
>>> env.close()
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from activestructure_gym._version import __version__

if TYPE_CHECKING:
    from activestructure_gym.config import ReconstructionConfig, configure
    from activestructure_gym.envs import ENV_IDS, ReconstructionEnv, register_envs
    from activestructure_gym.errors import InputError, InputWarning
    from activestructure_gym.evaluation import compare, open_comparison, read_run
    from activestructure_gym.explorer import Explorer
    from activestructure_gym.features import FEATURES, FeatureContext
    from activestructure_gym.geometry import PinholeCamera
    from activestructure_gym.geometry.frame import Frame
    from activestructure_gym.ground_truth import GroundTruth, ground_truth_of
    from activestructure_gym.mapping import GaussianMap, Mapper, MapperConfig
    from activestructure_gym.mapping.files import read_map
    from activestructure_gym.policies import POLICIES, Policy, make_env_and_policy, make_policy
    from activestructure_gym.reconstruction import Reconstruction
    from activestructure_gym.scenes import SCENES, Scene, load_scene
    from activestructure_gym.sources import SOURCES, Source
    from activestructure_gym.splatting.api import rasterize
    from activestructure_gym.worlds import WORLDS, Start, World

_PLACES = {
    "config": ("ReconstructionConfig", "configure"),
    "envs": ("ENV_IDS", "ReconstructionEnv", "register_envs"),
    "errors": ("InputError", "InputWarning"),
    "evaluation": ("compare", "open_comparison", "read_run"),
    "explorer": ("Explorer",),
    "features": ("FEATURES", "FeatureContext"),
    "geometry": ("PinholeCamera",),
    "geometry.frame": ("Frame",),
    "ground_truth": ("GroundTruth", "ground_truth_of"),
    "mapping": ("GaussianMap", "Mapper", "MapperConfig"),
    "mapping.files": ("read_map",),
    "policies": ("POLICIES", "Policy", "make_env_and_policy", "make_policy"),
    "reconstruction": ("Reconstruction",),
    "scenes": ("SCENES", "Scene", "load_scene"),
    "sources": ("SOURCES", "Source"),
    "splatting.api": ("rasterize",),
    "worlds": ("WORLDS", "Start", "World"),
}
_MODULE_OF = {name: f"{__name__}.{module}" for module, names in _PLACES.items() for name in names}

__all__ = [
    "ENV_IDS",
    "FEATURES",
    "POLICIES",
    "SCENES",
    "SOURCES",
    "WORLDS",
    "Explorer",
    "FeatureContext",
    "Frame",
    "GaussianMap",
    "GroundTruth",
    "InputError",
    "InputWarning",
    "Mapper",
    "MapperConfig",
    "PinholeCamera",
    "Policy",
    "Reconstruction",
    "ReconstructionConfig",
    "ReconstructionEnv",
    "Scene",
    "Source",
    "Start",
    "World",
    "__version__",
    "compare",
    "configure",
    "ground_truth_of",
    "load_scene",
    "make_env_and_policy",
    "make_policy",
    "open_comparison",
    "rasterize",
    "read_map",
    "read_run",
    "register_envs",
]


def __getattr__(name: str) -> Any:
    if name in _MODULE_OF:
        return getattr(import_module(_MODULE_OF[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


import_module(f"{__name__}.envs.registration").register_envs()
