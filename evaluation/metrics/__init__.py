"""Compute metrics: distances between point sets, and differences between images. All are pure functions of arrays."""

from activestructure_gym.evaluation.metrics.geometry import (
    GeometryScores,
    SurfaceSamples,
    completion_distances,
    geometry_scores,
    nearest_distances,
)
from activestructure_gym.evaluation.metrics.image import channel_psnr, depth_l1, ms_ssim, psnr, ssim

__all__ = [
    "GeometryScores",
    "SurfaceSamples",
    "channel_psnr",
    "completion_distances",
    "depth_l1",
    "geometry_scores",
    "ms_ssim",
    "nearest_distances",
    "psnr",
    "ssim",
]
