"""Define the interface of a mapper, and the configuration common to all mappers.

A mapper builds a map of 3D Gaussians from posed RGB-D frames. Any object with the six members of `MapperProtocol` can
be used; `adapted` adds the other members that features and observations need.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import ClassVar, Protocol

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping.gaussian_map import GaussianMap
from activestructure_gym.mapping.tracking import TrackingConfig
from activestructure_gym.ranges import check_ranges
from activestructure_gym.splatting import Rendering
from activestructure_gym.splatting.backends import BACKENDS


@dataclass(frozen=True)
class MappingReport:
    """Hold counts and losses of one mapping event: a new keyframe or a refinement."""

    added: int  # number of Gaussians inserted
    replaced: int  # number of Gaussians removed because the new ones at their surface are finer
    pruned: int  # number of Gaussians removed because they are transparent, too large or not finite
    left_out: int  # number of seeds not inserted because of ``max_gaussians``
    count: int  # number of Gaussians after the event
    new_share: float  # share of the image's pixels missing in the map, including those of removed coarse Gaussians
    views: tuple[int, ...]  # index of the keyframe used in each iteration
    color_loss: float  # mean colour error over the iterations; nan without any
    depth_loss: float  # mean depth error over the iterations, metres
    ssim: float  # mean SSIM over the iterations
    psnr: float  # PSNR of the new keyframe after the event, dB; nan for a refinement


class MapperProtocol(Protocol):
    """Define the members of a mapper. Poses are ``world_from_camera`` [4, 4] in metres: x right, y down, z forward."""

    @property
    def map(self) -> GaussianMap:
        """Return the map's Gaussians, in world coordinates."""

    @property
    def keyframes(self) -> Sequence[Frame]:
        """Return all observed frames in order. A mapper may store them with fewer pixels."""

    def observe(self, frame: Frame, *, iterations: int | None = None) -> MappingReport:
        """Add a keyframe and optimise the map.

        Parameters
        ----------
        frame : Frame
            Colours, depths in metres, pose and camera.
        iterations : int, optional
            Optimisation steps; None means `BaseMapperConfig.iterations`.

        Returns
        -------
        MappingReport
            Counts and losses of the event.
        """

    def refine(self, iterations: int, *, keyframe_indices: Sequence[int] | None = None) -> MappingReport:
        """Optimise the map without adding a keyframe.

        Parameters
        ----------
        iterations : int
            Optimisation steps.
        keyframe_indices : sequence of int, optional
            Keyframes to use; None means all.

        Returns
        -------
        MappingReport
            Counts and losses of the event.
        """

    def render(self, camera: PinholeCamera, world_from_camera: np.ndarray) -> Rendering:
        """Render colour [H, W, 3] in 0..1, accumulated depth [H, W] in metres and alpha [H, W] in 0..1 from a pose."""

    def render_depth_alpha(
        self,
        camera: PinholeCamera,
        world_from_camera: np.ndarray,  # [C, 4, 4]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Render accumulated depth [C, H, W] in metres and alpha [C, H, W] in 0..1 from C poses."""


@dataclass(frozen=True)
class BaseMapperConfig:
    """Configure a mapper: the fields common to all mappers.

    A subclass adds its own constants. It sets `made_by` to the class of its mapper, or overrides `make`.
    """

    made_by: ClassVar[str] = ""  # package.module:Class of the mapper; imported by `make` only, since it can load torch

    name: str = ""  # name under which the mapper is registered, or package.module:Name
    backend: str = "cpu"  # rasteriser: cpu (compiled kernels), gsplat (CUDA), reference (torch), or package.module:Name
    enabled: bool = True  # False: keyframes are stored, the map stays empty
    iterations: int = 5  # optimiser steps per keyframe (measured; 15 for higher quality)
    keyframe_reduction: int = 1  # factor by which stored keyframes have fewer pixels per side; seeds use all pixels
    tracking: TrackingConfig = field(default_factory=TrackingConfig)  # tracking of keyframe poses; off by default

    def __post_init__(self) -> None:
        BACKENDS.get(self.backend)
        check_ranges(self, {"iterations": "[0, 100000]", "keyframe_reduction": "[1, 64]"})

    def make(self, rng: np.random.Generator, bounds: np.ndarray, *, depth_noise_scale: float = 0.0) -> MapperProtocol:
        """Return a new mapper with an empty map: an object of the class `made_by`."""
        if not self.made_by:
            raise InputError(
                f"{type(self).__name__} makes no mapper: set made_by = 'package.module:Class' or define make"
            )
        module, _, name = self.made_by.partition(":")
        return getattr(import_module(module), name)(self, rng, bounds)
