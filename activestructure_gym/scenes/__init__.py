"""Scenes: generated apartments, meshes from files, and what can be known about them (free space, visible surface).

`load_scene` is the entrance; `SCENES` is where third parties add their own. Everything derived from a scene's mesh is
ground truth: sensor, reward, metrics and start poses may use it, policies and gains may not.
"""

from activestructure_gym.ground_truth.free_space import FreeSpace, free_space_of
from activestructure_gym.ground_truth.observable import ObservableSurface, observable_surface_of
from activestructure_gym.ground_truth.start_poses import check_start_pose
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
    "FreeSpace",
    "Hits",
    "ObservableSurface",
    "PartLabels",
    "PosedSequence",
    "RayCaster",
    "Scene",
    "SceneMesh",
    "cache_directory",
    "cached_arrays",
    "check_start_pose",
    "free_space_of",
    "load_matterport3d_scene",
    "load_mesh_scene",
    "load_replica_scene",
    "load_scene",
    "load_sequence",
    "observable_surface_of",
]
