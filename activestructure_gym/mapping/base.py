"""Define the interface of a mapper, and the configuration common to all mappers.

A mapper builds a Gaussian map from posed RGB-D frames. Any object with the six names of `MapperProtocol` can be used;
`adapted` adds the other methods that features and observations need.
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
    """Hold counts and losses of one mapping event."""

    added: int  # Gaussians seeded
    replaced: int  # Gaussians replaced by finer ones, since the frame is much closer to their surface
    pruned: int  # Gaussians removed: transparent, too large or not finite
    left_out: int  # seeds beyond ``max_gaussians``
    count: int  # Gaussians after the event
    new_share: float  # share of the image missing in the map; pixels of replaced Gaussians count as missing
    views: tuple[int, ...]  # keyframe index of every iteration
    color_loss: float  # mean over the iterations; nan without any
    depth_loss: float  # metres, mean over the iterations
    ssim: float  # mean over the iterations
    psnr: float  # dB, of the observed frame after the event; nan for a refinement


class MapperProtocol(Protocol):
    """Define the names of a mapper. Poses are ``world_from_camera`` [4, 4] in metres: x right, y down, z forward."""

    @property
    def map(self) -> GaussianMap:
        """Return the Gaussians, in world coordinates."""

    @property
    def keyframes(self) -> Sequence[Frame]:
        """Return every observed frame, in order; a mapper may store fewer pixels."""

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
        """Render the map: colour [H, W, 3] in 0..1, accumulated depth [H, W] in metres, alpha [H, W] in 0..1."""

    def render_depth_alpha(
        self,
        camera: PinholeCamera,
        world_from_camera: np.ndarray,  # [C, 4, 4]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Render accumulated depth [C, H, W] in metres and alpha [C, H, W] in 0..1 from C poses."""


@dataclass(frozen=True)
class BaseMapperConfig:
    """Configure a mapper: the fields common to all mappers.

    A subclass adds its own constants, and names its mapper in `made_by` or overrides `make`.
    """

    made_by: ClassVar[str] = ""  # package.module:Class; imported only when a mapper is made, since it can load torch

    name: str = ""  # registered name of the mapper, or package.module:Name
    backend: str = "cpu"  # cpu (our kernels), gsplat (CUDA), reference (torch), or package.module:Name
    iterations: int = 5  # per keyframe (row C15; 15 for higher quality)
    keyframe_reduction: int = 1  # divides the image size of stored keyframes, per side; seeds use all pixels
    tracking: TrackingConfig = field(default_factory=TrackingConfig)  # tracking of keyframe poses; off by default

    def __post_init__(self) -> None:
        BACKENDS.get(self.backend)
        check_ranges(self, {"iterations": "[0, 100000]", "keyframe_reduction": "[1, 64]"})

    def make(self, rng: np.random.Generator, bounds: np.ndarray, *, depth_noise_scale: float = 0.0) -> MapperProtocol:
        """Return an empty mapper: an object of the class `made_by`, from this configuration, ``rng`` and ``bounds``.

        Parameters
        ----------
        rng : numpy.random.Generator
            The only source of randomness.
        bounds : ndarray
            [2, 3] metres, the box around the scene.
        depth_noise_scale : float
            Depth noise of the sensor, as a factor on the axial noise of a Kinect; 0 without noise.

        Returns
        -------
        MapperProtocol
            The mapper.

        Raises
        ------
        InputError
            `made_by` is empty.
        """
        if not self.made_by:
            raise InputError(
                f"{type(self).__name__} makes no mapper: set made_by = 'package.module:Class' or define make"
            )
        module, _, name = self.made_by.partition(":")
        return getattr(import_module(module), name)(self, rng, bounds)
