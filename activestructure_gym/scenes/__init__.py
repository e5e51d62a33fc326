"""Scenes: generated apartments and meshes from files.

`load_scene` is the entrance; `SCENES` is where third parties add their own.
"""

from activestructure_gym.scenes.cache import cache_directory, cached_arrays
from activestructure_gym.scenes.library import SCENES, load_scene
from activestructure_gym.scenes.loaders.matterport3d import load_matterport3d_scene
from activestructure_gym.scenes.loaders.mesh_loader import load_mesh_scene
from activestructure_gym.scenes.loaders.replica import load_replica_scene
from activestructure_gym.scenes.loaders.sequence import PosedSequence, load_sequence
from activestructure_gym.scenes.raycaster import Hits, RayCaster
from activestructure_gym.scenes.scene import PartLabels, Scene, SceneMesh

__all__ = [
    "SCENES",
    "Hits",
    "PartLabels",
    "PosedSequence",
    "RayCaster",
    "Scene",
    "SceneMesh",
    "cache_directory",
    "cached_arrays",
    "load_matterport3d_scene",
    "load_mesh_scene",
    "load_replica_scene",
    "load_scene",
    "load_sequence",
]
