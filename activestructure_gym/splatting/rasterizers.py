"""The one way from a map to its pictures: a protocol, chosen by name, that the mapper and the features go through.

The map stands in numpy arrays on the host whatever the name is. What reads single Gaussians back out of a picture
(`fisher`, `passes`) is in the compiled kernels alone and takes these arrays, so it works beside every name.
"""

from __future__ import annotations

import functools
from typing import Protocol

import numpy as np

from activestructure_gym.errors import InputError, unknown_name
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.splatting import cpu
from activestructure_gym.splatting.backends import BACKENDS, Backend, backend_status


class Rasterizer(Protocol):
    """Pictures of a map and one step of its optimiser; rows and units of the arrays are those of `splatting.cpu`.

    It keeps nothing between two calls. ``unseen`` is a hint, the chunks of 1024 Gaussians that are known to be out of
    view: whoever does not use it gives the same pictures.
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
        """Colour, accumulated depth and alpha of one camera."""
        ...

    def render_depth_alpha(
        self,
        parameters: np.ndarray,  # [14, capacity] float32
        count: int,
        camera: PinholeCamera,
        world_from_camera: np.ndarray,  # [C, 4, 4]
    ) -> tuple[np.ndarray, np.ndarray]:  # accumulated depth [C, H, W], alpha [C, H, W]
        """Depth and alpha of many cameras."""
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
        """Render, compare, differentiate, and move the Gaussians that have a weight in some pixel (Adam without bias
        correction; the others keep their moments too).
        """
        ...


@functools.cache
def rasterizer(name: Backend) -> Rasterizer:
    """The rasteriser called ``name``.

    Raises `InputError` for an unknown name, or saying what is missing for one that cannot run here.
    """
    if name not in BACKENDS:
        raise unknown_name("splatting backend", name, BACKENDS)
    status = backend_status()[name]
    if status != "works":
        raise InputError(f"splatting backend '{name}' cannot run here ({status}); use mapper.backend=cpu.")
    if name == "cpu":
        return cpu
    from activestructure_gym.splatting.torch_rasterizer import TorchRasterizer

    return TorchRasterizer(name)
