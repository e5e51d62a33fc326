"""Define `GroundTruth`: a scene with its free space, start poses and observable surface."""

from __future__ import annotations

import warnings
from collections.abc import Hashable
from dataclasses import dataclass
from functools import cached_property
from weakref import WeakValueDictionary

import numpy as np

from activestructure_gym.errors import InputWarning
from activestructure_gym.ground_truth.free_space import FreeSpace, compute_free_space
from activestructure_gym.ground_truth.observable import SURFACE_SAMPLES, ObservableSurface, observable_surface_of
from activestructure_gym.ground_truth.regions import Regions
from activestructure_gym.ground_truth.start_poses import choose_start_poses
from activestructure_gym.scenes.cache import cached_arrays
from activestructure_gym.scenes.scene import Scene

HARDLY_SEEN = 0.3  # minimum visible fraction of the surface; with less, the region in use may be the wrong one


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """Hold a scene with its free space, start poses and observable surface, each computed on first use.

    Start poses, rewards, metrics and training labels take a `GroundTruth`. Features, observations and policies never
    do; the sensor takes the `Scene` alone. Properties raise `InputError` if the scene has no free space.
    """

    scene: Scene  # the mesh of which the ground truth is computed
    surface_samples: int = SURFACE_SAMPLES  # number of points drawn from the whole surface, visible or not

    @cached_property
    def free_space(self) -> FreeSpace:
        """Return the free space, with the scene's start poses."""
        return free_space_of(self.scene, self.__dict__.get("regions"))

    @cached_property
    def regions(self) -> Regions:
        """Return all regions of free space, one of which is used; slow, so only listings and messages read it."""
        return Regions(self.scene)

    @cached_property
    def observable_surface(self) -> ObservableSurface:
        """Return samples of the part of the surface that is visible from the free space."""
        return observable_surface_of(self.scene, self.free_space, self.surface_samples)


def warn_if_hardly_seen(truth: GroundTruth) -> None:
    """Warn if less than 30 % of the surface is visible from the free space in use."""
    if text := hardly_seen(truth):
        warnings.warn(f"scene '{truth.scene.name}': {text}", InputWarning, stacklevel=3)


def hardly_seen(truth: GroundTruth) -> str:
    """Return a message if less than 30 % of the surface is visible from the free space in use, else ""."""
    share = truth.observable_surface.area_share
    if share >= HARDLY_SEEN:
        return ""
    return (
        f"only {100 * share:.0f} % of the surface can be seen from the region of free space in use; "
        "`asg list scenes SCENE` lists the regions, and the scene's option inside=x,y,z uses another one"
    )


def free_space_of(scene: Scene, regions: Regions | None = None) -> FreeSpace:
    """Return the free space of a scene with its start poses, from the disk cache if available.

    ``regions`` are the scene's regions, if computed already. Raises `InputError` if there is no free space.
    """

    def compute() -> dict[str, np.ndarray]:
        space = compute_free_space(scene, regions)
        return {
            "origin": space.origin,
            "voxel_size": np.array(space.voxel_size),
            "clearance": space.clearance,
            "height": space.height,
            "start_poses": choose_start_poses(scene, space),
        }

    layout = {"origin": ("f8", 1), "voxel_size": ("f8", 0), "clearance": ("f4", 3), "height": ("f4", 3),
              "start_poses": ("f8", 3)}  # fmt: skip
    arrays = cached_arrays(f"free-space-{scene.content_hash}", compute, layout)
    return FreeSpace(
        origin=arrays["origin"],
        voxel_size=float(arrays["voxel_size"]),
        clearance=arrays["clearance"],
        height=arrays["height"],
        start_poses=arrays["start_poses"],
    )


_known: WeakValueDictionary[Hashable, GroundTruth] = WeakValueDictionary()


def ground_truth_of(scene: Scene) -> GroundTruth:
    """Return the ground truth of a scene; the same object for equal scenes, as long as it is referenced.

    Scenes of equal content but different name, source or recorded views have separate objects.

    Parameters
    ----------
    scene
        The scene; properties are computed on first use.

    Returns
    -------
    GroundTruth
        Free space, start poses and observable surface, metres in the world frame.

    Examples
    --------
    >>> from activestructure_gym.scenes import load_scene
    >>> truth = ground_truth_of(load_scene("box"))
    >>> truth is ground_truth_of(load_scene("box"))
    True
    >>> truth.free_space.start_poses.shape[1:]
    (4, 4)
    """
    key = (scene.content_hash, scene.name, scene.source, _views_of(scene))
    truth = _known.get(key)
    if truth is None:
        truth = _known[key] = GroundTruth(scene)
    return truth


def _views_of(scene: Scene) -> Hashable:
    """Return a key that identifies the recorded views of a scene."""
    views = scene.evaluation_views
    if views is None:
        return None
    return views.camera, views.world_from_camera.tobytes(), views.rgb_files, views.depth_files, views.depth_scale
