"""Compute the mapping loss and Adam step of the compiled kernels in torch."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import torch

from activestructure_gym.splatting.cpu import LossWeights

_TAPS, _SIGMA = 11, 1.5  # pixels: width and standard deviation of the blur in SSIM [ssim]
_C1, _C2 = 0.01**2, 0.03**2  # constants of SSIM for colours in 0..1 [ssim]


class MappingLoss(NamedTuple):
    """Hold the weighted sum of a mapping loss, and its terms as in `StepLosses`."""

    total: torch.Tensor
    terms: torch.Tensor  # [3] without gradient: colour difference, depth difference in metres, SSIM


def mapping_loss(
    color: torch.Tensor,  # [H, W, 3]
    depth: torch.Tensor,  # [H, W] accumulated depth, metres
    alpha: torch.Tensor,  # [H, W]
    target_rgb: torch.Tensor,  # [H, W, 3] 0..1
    target_depth: torch.Tensor,  # [H, W] metres, 0 = no return
    weights: LossWeights,
) -> MappingLoss:
    """Return the loss of one rendered image, as defined at `LossWeights`.

    Pixels are left out by masks and not by indices, so that nothing waits for a device.
    """
    measured = target_depth > 0
    by_color = (color - target_rgb).abs().mean()
    compared, shown = measured, depth
    if weights.normalised_depth:
        compared = measured & (alpha.detach() > 0.5)
        shown = depth / alpha.clamp_min(0.5)
    by_depth = ((shown - target_depth).abs() * compared).sum() / measured.sum().clamp_min(1)
    missing = ((1.0 - alpha).square() * measured).sum() / alpha.numel()
    total = weights.image * weights.l1_share * by_color + weights.depth * by_depth + weights.alpha * missing
    of_ssim, similarity = weights.image * (1.0 - weights.l1_share), by_color.new_full((), torch.nan)
    if of_ssim:
        similarity = ssim(color, target_rgb)
        total = total + of_ssim * (1.0 - similarity)
    return MappingLoss(total, torch.stack([by_color, by_depth, similarity]).detach())


def ssim(image: torch.Tensor, target: torch.Tensor) -> torch.Tensor:  # [H, W, 3] each -> scalar
    """Return the mean structural similarity over pixels and channels, with zeros outside the images."""
    x, y = image.permute(2, 0, 1), target.permute(2, 0, 1)
    mean_x, mean_y, square_x, square_y, product = _blurred(torch.stack([x, y, x * x, y * y, x * y]))
    variances = square_x - mean_x**2 + square_y - mean_y**2
    covariance = product - mean_x * mean_y
    values = (2.0 * mean_x * mean_y + _C1) * (2.0 * covariance + _C2)
    return (values / ((mean_x**2 + mean_y**2 + _C1) * (variances + _C2))).mean()


def _blurred(images: torch.Tensor) -> torch.Tensor:  # [K, 3, H, W] -> [K, 3, H, W]
    taps, half = _taps().to(images), _TAPS // 2
    planes = images.reshape(-1, 1, *images.shape[2:])
    planes = torch.nn.functional.conv2d(planes, taps.reshape(1, 1, 1, -1), padding=(0, half))
    return torch.nn.functional.conv2d(planes, taps.reshape(1, 1, -1, 1), padding=(half, 0)).reshape(images.shape)


@cache
def _taps() -> torch.Tensor:  # [11] float64
    taps = torch.exp(-0.5 * ((torch.arange(_TAPS, dtype=torch.float64) - _TAPS // 2) / _SIGMA) ** 2)
    return taps / taps.sum()


def adam(
    parameters: torch.Tensor,  # [N, D], changed in place
    gradient: torch.Tensor,  # [N, D]
    first_moment: torch.Tensor,  # [N, D], changed in place
    second_moment: torch.Tensor,  # [N, D], changed in place
    seen: torch.Tensor,  # [N] bool: the others keep parameters and moments
    *constants: float,  # learning rate, beta1, beta2, epsilon
) -> None:
    """Take an Adam step without bias correction ([adam]), as gsplat's compiled function of this name does."""
    rate, beta1, beta2, epsilon = constants
    mask = seen[:, None]
    first_moment.lerp_(torch.where(mask, gradient, first_moment), 1.0 - beta1)
    second_moment.lerp_(torch.where(mask, gradient.square(), second_moment), 1.0 - beta2)
    parameters -= torch.where(mask, rate * first_moment / (second_moment.sqrt() + epsilon), 0.0)
