"""`GroundTruth`: a scene with its free space, start poses and observable surface; who reads them takes this type."""

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

HARDLY_SEEN = 0.3  # share of the surface; where less can be seen, the region in use may be the wrong one


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """A scene with its free space, start poses and observable surface, computed when they are first asked for.

    Start poses, the reward, metrics and the labels of training take a `GroundTruth`. Features, observations and
    policies never do; the sensor takes the `Scene` alone.

    Raises `InputError` from its properties where the scene has no free space.
    """

    scene: Scene  # whose truth it is
    surface_samples: int = SURFACE_SAMPLES  # points drawn from the whole surface, seen or not

    @cached_property
    def free_space(self) -> FreeSpace:
        """The free space, with the scene's start poses."""
        return free_space_of(self.scene, self.__dict__.get("regions"))

    @cached_property
    def regions(self) -> Regions:
        """All regions of free space, of which one is used. They are costly; only listings and messages ask for them."""
        return Regions(self.scene)

    @cached_property
    def observable_surface(self) -> ObservableSurface:
        """The part of the surface that some free pose can see."""
        return observable_surface_of(self.scene, self.free_space, self.surface_samples)


def warn_if_hardly_seen(truth: GroundTruth) -> None:
    """Give an `InputWarning` where less than 30 % of the surface can be seen from the free space in use."""
    if text := hardly_seen(truth):
        warnings.warn(f"scene '{truth.scene.name}': {text}", InputWarning, stacklevel=3)


def hardly_seen(truth: GroundTruth) -> str:
    """Say that less than 30 % of the surface can be seen from the free space in use; empty where more can be."""
    share = truth.observable_surface.area_share
    if share >= HARDLY_SEEN:
        return ""
    return (
        f"only {100 * share:.0f} % of the surface can be seen from the region of free space in use; "
        "`asg scenes SCENE` lists the regions, and the scene's option inside=x,y,z uses another one"
    )


def free_space_of(scene: Scene, regions: Regions | None = None) -> FreeSpace:
    """Return the free space of a scene with its start poses, from the cache on disk where it has been computed before.

    ``regions`` are those of the scene, where they have been found already. Raises `InputError` where no free space is
    found.
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
    """The truth of a scene; the same object for the same scene, loaded again, as long as somebody holds it.

    Scenes of one content that differ in their name, their source or their recorded views have one each.

    Parameters
    ----------
    scene
        The scene; nothing is computed before it is asked for.

    Returns
    -------
    GroundTruth
        Free space, start poses and observable surface, metres in the world's frame.

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
    """What tells the recorded views of a scene from others."""
    views = scene.evaluation_views
    if views is None:
        return None
    return views.camera, views.world_from_camera.tobytes(), views.rgb_files, views.depth_files, views.depth_scale
