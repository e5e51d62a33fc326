"""`FeatureContext`: the parts of the reconstruction that a feature may read."""

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

T = TypeVar("T")


@dataclass(frozen=True)
class FeatureContext:
    """The reconstruction and the candidates of one step.

    No scene is in here: no feature can reach ground truth but where the agent stands.
    """

    mapper: KeyframeMapper  # the Gaussian map and its keyframes
    volume: VoxelVolume  # known free, occupied and unknown space
    planes: PlaneSceneGraph  # as of the last keyframe
    camera: PinholeCamera  # the sensor's camera at the reduced size of `ViewConfig.scoring_scale`
    bounds: np.ndarray  # [2, 3] metres, the workspace
    coverage_alpha: float  # a pixel is covered where alpha exceeds this
    max_range: float  # metres, the sensor's
    world_from_camera: np.ndarray  # [K, 4, 4] the candidates
    agent: Agent | None = None  # how it would get to them; None: nobody stands anywhere
    revisit: np.ndarray | None = None  # [K] bool, as the table says; None: whose pose is a keyframe's as reported

    @cached_property
    def _rendered(self) -> tuple[np.ndarray, np.ndarray]:
        depth, alpha = (image.view() for image in self.mapper.render_depth_alpha(self.camera, self.world_from_camera))
        depth.flags.writeable = alpha.flags.writeable = False  # one feature must not change what the next one reads
        return depth, alpha

    @property
    def depth(self) -> np.ndarray:  # [K, h, w] metres, accumulated (sum of weight x depth)
        """The map's depth from every candidate; rendered once, shared by all features, and read only."""
        return self._rendered[0]

    @property
    def alpha(self) -> np.ndarray:  # [K, h, w] in 0..1
        """The map's accumulated opacity from every candidate, read only."""
        return self._rendered[1]

    @cached_property
    def visible(self) -> np.ndarray:  # [K, N] bool
        """Which planes of the graph every candidate would see (V_c^vis), occlusion included."""
        return visible_planes(self.planes.nodes, self.camera, self.world_from_camera, self.volume)

    @cached_property
    def revisits(self) -> np.ndarray:  # [K] bool
        """Which candidates are a stored keyframe's pose."""
        if self.revisit is not None:
            return self.revisit
        known = np.array([frame.world_from_camera for frame in self.mapper.keyframes]).reshape(-1, 1, 4, 4)
        return (np.abs(known - self.world_from_camera) < 1e-6).all(axis=(2, 3)).any(axis=0)

    def once(self, compute: Callable[[FeatureContext], T]) -> T:
        """``compute(self)``, called at most once per step: what several features have in common."""
        if compute not in self._results:
            self._results[compute] = compute(self)
        return self._results[compute]

    def episode(self, make: Callable[[FeatureContext], T]) -> T:
        """``make(self)``, called at most once per episode: what a feature keeps from one step to the next.

        The object belongs to the episode's map and is copied with it. With methods ``before_steps`` and ``after_steps``
        it is called around the optimisation steps of every mapping event from then on.
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
    stride: int,  # pixels between rays
) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
    """Arguments that all kernels share which walk the rays of pixels through the voxel grid.

    The corner of voxel (0, 0, 0) [3], the size of a voxel, the poses [K, 4, 4], and the rays [h, w, 3] in the camera's
    frame with depth 1.
    """
    poses = np.ascontiguousarray(world_from_camera, dtype=np.float64)
    rays = camera.rays()[::stride, ::stride].astype(np.float64)
    return volume.origin.astype(np.float64), float(volume.config.voxel_size), poses, rays
