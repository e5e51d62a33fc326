"""Render 3D Gaussians differentiably: on CPUs, on CUDA devices with gsplat, and in plain torch as reference for tests.

The mapper and the features use an implementation of `rasterizers` by its name: ``cpu`` works on numpy arrays, and the
others have the same protocol. ``rasterize`` (torch, autograd) is for any other loss. Names are loaded at their first
use, so a mapper on the CPU does not load torch.
"""

from typing import TYPE_CHECKING

from activestructure_gym.splatting.backends import backend_status
from activestructure_gym.splatting.cpu import (
    LossWeights,
    Rendering,
    StepLosses,
    mapping_step,
    render,
    render_depth_alpha,
)
from activestructure_gym.splatting.ssim import ssim_and_gradient

if TYPE_CHECKING:
    from activestructure_gym.splatting.api import Rasterization, camera_twist_gradient, parameter_rows, rasterize

_OF_TORCH = ("Rasterization", "camera_twist_gradient", "parameter_rows", "rasterize")

__all__ = [
    "LossWeights",
    "Rasterization",
    "Rendering",
    "StepLosses",
    "backend_status",
    "camera_twist_gradient",
    "mapping_step",
    "parameter_rows",
    "rasterize",
    "render",
    "render_depth_alpha",
    "ssim_and_gradient",
]


def __getattr__(name: str) -> object:
    if name in _OF_TORCH:
        from activestructure_gym.splatting import api

        return getattr(api, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
