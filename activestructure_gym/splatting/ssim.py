"""Compute the structural similarity of two images and its gradient (blur of 11 pixels, sigma 1.5; [ssim]).

Outside the images all values are 0. Only the sum of the two variances enters SSIM, so four blurs give the value and
three the gradient. The loops are those of the mapping step in `image_losses`.
"""

from __future__ import annotations

import numpy as np

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.splatting.workspace import PooledWorkspace


def ssim_and_gradient(
    image: np.ndarray,  # [H, W, 3] float32 0..1
    target: np.ndarray,  # [H, W, 3] float32 0..1
    *,
    threads: int | None = None,
) -> tuple[float, np.ndarray]:  # SSIM, [H, W, 3] gradient
    """Return the mean SSIM over pixels and channels, and its gradient with respect to ``image``."""
    if image.shape != target.shape or image.ndim != 3 or image.shape[2] != 3:
        raise ValueError(f"two images [H, W, 3] of one size are needed, got {image.shape} and {target.shape}")
    height, width = image.shape[:2]
    pooled = PooledWorkspace()
    workspace = pooled.workspace
    workspace.show(image, PinholeCamera.from_size(width, height), threads=threads)
    _, _, ssim = workspace.losses(target, np.zeros((height, width), np.float32), 0.0, 1.0, 0.0)
    return ssim, -workspace.pixels_of(workspace.by_pictures.color)
