"""Differentiable rendering of 3D Gaussians on plain CPUs, on CUDA through gsplat, and in plain torch as the oracle.

``cpu`` (numpy in, numpy out) is what the mapper uses; ``api.rasterize`` (torch, autograd) is for any other loss and is
imported from its own module so that the mapper does not load torch.
"""

from activestructure_gym.splatting.backends import backend_status
from activestructure_gym.splatting.cpu import (
    LossWeights,
    PoseGradient,
    Rendering,
    StepLosses,
    TrackingWeights,
    mapping_step,
    pose_gradient,
    render,
    render_depth_alpha,
)
from activestructure_gym.splatting.ssim import ssim_and_gradient

__all__ = [
    "LossWeights",
    "PoseGradient",
    "Rendering",
    "StepLosses",
    "TrackingWeights",
    "backend_status",
    "mapping_step",
    "pose_gradient",
    "render",
    "render_depth_alpha",
    "ssim_and_gradient",
]
