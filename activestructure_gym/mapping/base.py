"""The interface of a mapper, and the configuration that every mapper has.

A mapper turns posed RGB-D frames into a Gaussian map. An object with the six names of `MapperProtocol` plugs in;
`adapted` derives from them what features and observations need besides.
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
    """Counts and losses of one mapping event."""

    added: int  # Gaussians seeded
    replaced: int  # Gaussians removed because the frame shows their surface from much closer
    pruned: int  # Gaussians removed: transparent, too large or not finite
    left_out: int  # seeds beyond ``max_gaussians``
    count: int  # Gaussians after the event
    new_share: float  # share of the image's pixels missing in the map; pixels of replaced Gaussians count as missing
    views: tuple[int, ...]  # keyframe of every iteration
    color_loss: float  # mean over the iterations; nan without any
    depth_loss: float  # metres, mean over the iterations
    ssim: float  # mean over the iterations
    psnr: float  # decibel, of the observed frame after the event; nan for a refinement


class MapperProtocol(Protocol):
    """What a mapper must have. Poses are ``world_from_camera`` [4, 4], metres, x right, y down, z forward."""

    @property
    def map(self) -> GaussianMap:
        """Return the Gaussians, in world coordinates."""

    @property
    def keyframes(self) -> Sequence[Frame]:
        """Return every observed frame, in order; a mapper may store fewer pixels."""

    def observe(self, frame: Frame, *, iterations: int | None = None) -> MappingReport:
        """Add a keyframe and optimise the map; ``iterations`` defaults to those of the configuration."""

    def refine(self, iterations: int, *, keyframe_indices: Sequence[int] | None = None) -> MappingReport:
        """Optimise over all keyframes, or over the given ones, without adding any."""

    def render(self, camera: PinholeCamera, world_from_camera: np.ndarray) -> Rendering:
        """Render the map: colour [H, W, 3] in 0..1, accumulated depth [H, W] in metres, alpha [H, W] in 0..1."""

    def render_depth_alpha(
        self,
        camera: PinholeCamera,
        world_from_camera: np.ndarray,  # [C, 4, 4]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Render accumulated depth [C, H, W] in metres and alpha [C, H, W] from many poses."""


@dataclass(frozen=True)
class BaseMapperConfig:
    """Configure a mapper: the fields that every mapper has.

    A subclass adds its own constants, and names its mapper by `made_by` or overrides `make`.
    """

    made_by: ClassVar[str] = ""  # package.module:Class, imported when the mapper is made: it may load torch

    name: str = ""  # registered name of the mapper, or package.module:Name
    backend: str = "cpu"  # cpu (our kernels), gsplat (CUDA), reference (torch), or package.module:Name
    iterations: int = 5  # per observed frame (row C15; 15 for quality)
    keyframe_reduction: int = 1  # stored keyframes have this factor fewer pixels a side; seeds use all pixels
    tracking: TrackingConfig = field(default_factory=TrackingConfig)  # of the pose of every keyframe; off by default

    def __post_init__(self) -> None:
        BACKENDS.get(self.backend)
        check_ranges(self, {"iterations": "[0, 100000]", "keyframe_reduction": "[1, 64]"})

    def make(self, rng: np.random.Generator, bounds: np.ndarray, *, depth_noise_scale: float = 0.0) -> MapperProtocol:
        """Return an empty mapper: an object of the class `made_by`, from this configuration, ``rng`` and ``bounds``.

        Raises `InputError` without such a class.

        Parameters
        ----------
        rng
            The only source of randomness.
        bounds
            [2, 3] metres, the box around the scene.
        depth_noise_scale
            Factor on a Kinect's axial depth noise that the sensor has; 0 without noise.
        """
        if not self.made_by:
            raise InputError(
                f"{type(self).__name__} makes no mapper: set made_by = 'package.module:Class' or define make"
            )
        module, _, name = self.made_by.partition(":")
        return getattr(import_module(module), name)(self, rng, bounds)
