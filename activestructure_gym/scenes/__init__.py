"""Load scenes: generated apartments and meshes from files.

Use `load_scene`; register your own scenes in `SCENES`.
"""

from activestructure_gym.scenes.cache import cache_directory, cached_arrays
from activestructure_gym.scenes.library import SCENES, load_scene
from activestructure_gym.scenes.loaders.habitat import load_habitat_scene
from activestructure_gym.scenes.loaders.hm3d import load_gibson_scene, load_hm3d_scene
from activestructure_gym.scenes.loaders.matterport3d import load_matterport3d_scene
from activestructure_gym.scenes.loaders.mesh_loader import load_mesh_scene
from activestructure_gym.scenes.loaders.procthor import load_procthor_scene
from activestructure_gym.scenes.loaders.replica import load_replica_scene
from activestructure_gym.scenes.loaders.scannet import load_scannet_scene, load_scannetpp_scene
from activestructure_gym.scenes.loaders.sequence import PosedSequence, load_sequence
from activestructure_gym.scenes.raycaster import RayCaster
from activestructure_gym.scenes.rays import Hits
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
    "load_gibson_scene",
    "load_habitat_scene",
    "load_hm3d_scene",
    "load_matterport3d_scene",
    "load_mesh_scene",
    "load_procthor_scene",
    "load_replica_scene",
    "load_scannet_scene",
    "load_scannetpp_scene",
    "load_scene",
    "load_sequence",
]
