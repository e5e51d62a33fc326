"""Define the common protocol for rendering and optimising a map, with implementations by name.

The mapper and the features use it. The map is always in numpy arrays on the host. Functions that read single Gaussians
back from an image (`fisher`, `passes`) exist only as compiled CPU kernels; they take the same arrays, so they work with
every implementation.
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
    """Render a map and run optimiser steps; rows and units of the arrays are those of `splatting.cpu`.

    No state is kept between calls. ``unseen`` is a hint, the chunks of 1024 Gaussians known to be outside the view;
    images are the same without it.
    """

    def render(
        self,
        parameters: np.ndarray,  # [14, capacity] float32
        count: int,
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
        count: int,
        camera: PinholeCamera,
        world_from_camera: np.ndarray,  # [C, 4, 4]
    ) -> tuple[np.ndarray, np.ndarray]:  # accumulated depth [C, H, W], alpha [C, H, W]
        """Render accumulated depth and alpha of many cameras."""
        ...

    def mapping_step(
        self,
        parameters: np.ndarray,  # [14, capacity] float32, changed in place
        first_moment: np.ndarray,  # [14, capacity] float32, changed in place
        second_moment: np.ndarray,  # [14, capacity] float32, changed in place
        count: int,
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
        """Render, compare, differentiate, and update the Gaussians that contribute to some pixel.

        The update is Adam without bias correction; other Gaussians keep their moments.
        """
        ...


@functools.cache
def rasterizer(name: str) -> Rasterizer:
    """Return the rasteriser called ``name``.

    Raises `InputError` for an unknown name, or with what is missing for one that cannot run here.
    """
    backend = BACKENDS.get(name)
    if (status := backend.status()) != WORKS:
        raise InputError(f"splatting backend '{name}' cannot run here ({status}); use mapper.backend=cpu.")
    made: Rasterizer = backend.make()
    return made
