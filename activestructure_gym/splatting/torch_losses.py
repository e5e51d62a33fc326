"""Compute the mapping loss and Adam step of the compiled kernels in torch."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
import torch

from activestructure_gym.splatting.cpu import LossWeights

_TAPS, _SIGMA = 11, 1.5  # pixels: width and standard deviation of the blur in SSIM [ssim]
_C1, _C2 = 0.01**2, 0.03**2  # constants of SSIM for colours in 0..1 [ssim]


class MappingLoss(NamedTuple):
    """Hold the weighted sum of a mapping loss, and its terms as in `StepLosses`."""

    total: torch.Tensor
    color: float  # mean absolute colour difference
    depth: float  # metres
    ssim: float  # mean SSIM; nan if its weight is 0


def mapping_loss(
    color: torch.Tensor,  # [H, W, 3]
    depth: torch.Tensor,  # [H, W] accumulated depth, metres
    alpha: torch.Tensor,  # [H, W]
    target_rgb: torch.Tensor,  # [H, W, 3] 0..1
    target_depth: torch.Tensor,  # [H, W] metres, 0 = no return
    weights: LossWeights,
) -> MappingLoss:
    """Return the loss of one rendered image, as defined at `LossWeights`."""
    measured = target_depth > 0
    by_color = (color - target_rgb).abs().mean()
    compared = measured & (alpha.detach() > 0.5) if weights.normalised_depth else measured
    shown = depth[compared] / alpha[compared] if weights.normalised_depth else depth[compared]
    by_depth = (shown - target_depth[compared]).abs().sum() / max(1, int(measured.sum()))
    missing = (1.0 - alpha[measured]).square().sum() / alpha.numel()
    total = weights.image * weights.l1_share * by_color + weights.depth * by_depth + weights.alpha * missing
    of_ssim, similarity = weights.image * (1.0 - weights.l1_share), float("nan")
    if of_ssim:
        alike = ssim(color, target_rgb)
        total, similarity = total + of_ssim * (1.0 - alike), float(alike.detach())
    return MappingLoss(total, float(by_color.detach()), float(by_depth.detach()), similarity)


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


class Adam(NamedTuple):
    """Hold the constants of an Adam step without bias correction ([adam])."""

    learning_rates: np.ndarray  # [14]
    beta1: float
    beta2: float
    epsilon: float

    def step(
        self,
        gradient: torch.Tensor,  # [14, n]
        parameters: torch.Tensor,  # [14, n]
        first_moment: torch.Tensor,  # [14, n]
        second_moment: torch.Tensor,  # [14, n]
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return parameters, first moment and second moment after one step."""
        first_moment = first_moment + (gradient - first_moment) * (1.0 - self.beta1)
        second_moment = second_moment + (gradient.square() - second_moment) * (1.0 - self.beta2)
        rates = torch.as_tensor(self.learning_rates).to(gradient)[:, None]
        parameters = parameters - rates * first_moment / (second_moment.sqrt() + self.epsilon)
        return parameters, first_moment, second_moment
