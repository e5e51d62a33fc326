"""Define `FeatureContext`, the parts of the reconstruction that a feature may read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.mapping import KeyframeMapper
from activestructure_gym.motion import Agent
from activestructure_gym.planes import PlaneSceneGraph
from activestructure_gym.views.visibility import visible_planes
from activestructure_gym.volume import VoxelVolume
from activestructure_gym.volume.rays import rays_of_pixels

T = TypeVar("T")


@dataclass(frozen=True)
class FeatureContext:
    """Hold the reconstruction and the candidates of one step.

    It has no scene: the true pose of the agent is the only ground truth that a feature can reach.
    """

    mapper: KeyframeMapper  # the Gaussian map and its keyframes
    volume: VoxelVolume  # free, occupied and unknown voxels
    planes: PlaneSceneGraph  # graph of the planes, updated with the last keyframe
    camera: PinholeCamera  # the sensor's camera, reduced by `ViewConfig.scoring_scale`
    bounds: np.ndarray  # [2, 3] metres, the workspace
    coverage_alpha: float  # a pixel is covered where alpha exceeds this
    max_range: float  # metres, range of the sensor
    world_from_camera: np.ndarray  # [K, 4, 4] poses of the candidates
    agent: Agent | None = None  # plans paths to the candidates; None without an agent
    revisit: np.ndarray | None = None  # [K] bool, see `revisits`; None: found by comparison with the keyframe poses

    @cached_property
    def _rendered(self) -> tuple[np.ndarray, np.ndarray]:
        depth, alpha = (image.view() for image in self.mapper.render_depth_alpha(self.camera, self.world_from_camera))
        depth.flags.writeable = alpha.flags.writeable = False  # all features share these arrays
        return depth, alpha

    @property
    def depth(self) -> np.ndarray:  # [K, h, w] metres, accumulated (sum of weight x depth)
        """Return the depth images of the map from every candidate; rendered once for all features, read-only."""
        return self._rendered[0]

    @property
    def alpha(self) -> np.ndarray:  # [K, h, w] in 0..1
        """Return the images of accumulated opacity of the map from every candidate; read-only."""
        return self._rendered[1]

    @cached_property
    def visible(self) -> np.ndarray:  # [K, N] bool
        """Return which planes of the scene graph each candidate sees (V_c^vis of Sec. 3.4), with occlusion."""
        return visible_planes(self.planes.nodes, self.camera, self.world_from_camera, self.volume)

    @cached_property
    def revisits(self) -> np.ndarray:  # [K] bool
        """Return which candidates are revisits, which means that they have the pose of a stored keyframe."""
        if self.revisit is not None:
            return self.revisit
        known = np.array([frame.world_from_camera for frame in self.mapper.keyframes]).reshape(-1, 1, 4, 4)
        return (np.abs(known - self.world_from_camera) < 1e-6).all(axis=(2, 3)).any(axis=0)

    def once(self, compute: Callable[[FeatureContext], T]) -> T:
        """Return ``compute(self)``, computed at most once per step, so that several features can share the result."""
        if compute not in self._results:
            self._results[compute] = compute(self)
        return self._results[compute]

    def episode(self, make: Callable[[FeatureContext], T]) -> T:
        """Return the object ``make(self)``, created at most once per episode; features keep state between steps in it.

        The mapper owns the object, and copies of the mapper copy it. If the object has the methods ``before_steps`` and
        ``after_steps``, the mapper calls them around the optimisation steps of every later mapping event.
        """
        memory = self.mapper.memory
        if make not in memory:
            memory[make] = make(self)
        return memory[make]

    @cached_property
    def _results(self) -> dict[Callable[[FeatureContext], Any], Any]:
        return {}


def grid_rays(
    volume: VoxelVolume,
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [K, 4, 4]
    stride: int | None = None,  # pixels between rays; None: about 40 rays per image row
) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
    """Return the geometric arguments of the kernels that trace pixel rays through the voxel grid.

    They are the corner of voxel (0, 0, 0) in metres [3], the voxel size in metres, and the results of `rays_of_pixels`.
    """
    poses, rays = rays_of_pixels(camera, world_from_camera, stride)
    return volume.origin.astype(np.float64), float(volume.voxel_size), poses, rays
