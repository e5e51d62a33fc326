"""Define the protocol of a rasteriser, with which the mapper and the features render and optimise a map.

Implementations have names. The map is always in numpy arrays on the host. Functions that compute results per Gaussian
(`fisher`, `passes`) exist only as compiled CPU kernels. They use the same arrays, so they work with every
implementation.
"""

from __future__ import annotations

import functools
from typing import Protocol

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.splatting import cpu
from activestructure_gym.splatting.backends import BACKENDS, WORKS


class Rasterizer(Protocol):
    """Render a map and take optimiser steps; rows and units of the arrays are described at `splatting.cpu`.

    No state is kept between calls. ``unseen`` marks chunks of 1024 Gaussians that are known to be outside the view. It
    only saves time: images are the same without it.
    """

    def render(
        self,
        parameters: np.ndarray,  # [14, capacity] float32
        count: int,  # number of Gaussians
        camera: PinholeCamera,
        world_from_camera: np.ndarray,  # [4, 4]
        *,
        unseen: np.ndarray | None = None,  # [chunks] bool
    ) -> cpu.Rendering:
        """Render colour, accumulated depth and alpha of one camera."""
        ...

    def render_depth_alpha(
        self,
        parameters: np.ndarray,  # [14, capacity] float32
        count: int,  # number of Gaussians
        camera: PinholeCamera,
        world_from_camera: np.ndarray,  # [C, 4, 4]
    ) -> tuple[np.ndarray, np.ndarray]:  # accumulated depth [C, H, W], alpha [C, H, W]
        """Render accumulated depth (metres) and alpha of C cameras."""
        ...

    def mapping_step(
        self,
        parameters: np.ndarray,  # [14, capacity] float32, changed in place
        first_moment: np.ndarray,  # [14, capacity] float32, changed in place
        second_moment: np.ndarray,  # [14, capacity] float32, changed in place
        count: int,  # number of Gaussians
        camera: PinholeCamera,
        world_from_camera: np.ndarray,  # [4, 4]
        target_rgb: np.ndarray,  # [H, W, 3] float32 0..1
        target_depth: np.ndarray,  # [H, W] float32 metres, 0 = no return
        *,
        weights: cpu.LossWeights,
        learning_rates: np.ndarray,  # [14] float32
        beta1: float = 0.9,
        beta2: float = 0.999,
        epsilon: float = 1e-15,
        isotropic: bool = False,
        unseen: np.ndarray | None = None,  # [chunks] bool
    ) -> cpu.StepLosses:
        """Take one optimiser step on the loss of one image; only Gaussians that contribute to some pixel change.

        The step is Adam without bias correction; other Gaussians keep their moments.
        """
        ...


@functools.cache
def rasterizer(name: str) -> Rasterizer:
    """Return the rasteriser registered as ``name``.

    Raises `InputError` for an unknown name, and for a rasteriser that cannot run here, with what is missing.
    """
    backend = BACKENDS.get(name)
    if (status := backend.status()) != WORKS:
        raise InputError(f"splatting backend '{name}' cannot run here ({status}); use mapper.backend=cpu.")
    made: Rasterizer = backend.make()
    return made
