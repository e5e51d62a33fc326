"""Define the protocol of a rasteriser, with which the mapper and the features render and optimise a map.

Implementations have names. The map is in numpy arrays on the host, except during the steps of a mapping event.
Functions that compute results per Gaussian (`fisher`, `passes`) exist only as compiled CPU kernels. They use the same
arrays, so they work with every implementation.
"""

from __future__ import annotations

import functools
from typing import Protocol

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.splatting import cpu
from activestructure_gym.splatting.backends import BACKENDS, WORKS


class Rasterizer(Protocol):
    """Render a map and take optimiser steps; rows and units of the arrays are described at `splatting.cpu`.

    No state is kept between calls, except by the `Steps` of an event. ``unseen`` marks chunks of 1024 Gaussians that
    are known to be outside the view. It only saves time: images are the same without it.
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

    def render_values(
        self,
        parameters: np.ndarray,  # [14, capacity] float32
        count: int,  # number of Gaussians
        camera: PinholeCamera,
        world_from_camera: np.ndarray,  # [C, 4, 4]
        values: np.ndarray,  # [N] one per Gaussian
    ) -> np.ndarray:  # [C, H, W] float32
        """Render one number per Gaussian from C cameras, blended as a channel of `render`'s colour is."""
        ...

    def begin(
        self,
        parameters: np.ndarray,  # [14, capacity] float32
        first_moment: np.ndarray,  # [14, capacity] float32
        second_moment: np.ndarray,  # [14, capacity] float32
        count: int,  # number of Gaussians
        *,
        weights: cpu.LossWeights,
        beta1: float = 0.9,
        beta2: float = 0.999,
        isotropic: bool = False,
    ) -> Steps:
        """Begin the optimiser steps of a mapping event on a map and its Adam moments.

        Until `Steps.end`, the arrays must be neither read nor changed.
        """
        ...


class Steps(Protocol):
    """Take the optimiser steps of a mapping event; a device may hold the map in the meantime."""

    def step(
        self,
        frame: Frame,
        *,
        learning_rates: np.ndarray,  # [14] float32
        epsilon: float = 1e-15,
        unseen: np.ndarray | None = None,  # [chunks] bool
    ) -> None:
        """Take one optimiser step on the loss of a frame; only Gaussians that contribute to some pixel change.

        The step is Adam without bias correction; other Gaussians keep their moments.
        """
        ...

    def end(self) -> np.ndarray:  # [steps, 3] float64
        """Write the map into its arrays, and return the terms of `StepLosses` of every step."""
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
