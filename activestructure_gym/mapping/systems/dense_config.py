"""Define the configuration common to systems whose Adam steps change every Gaussian."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.mapping.base import BaseMapperConfig
from activestructure_gym.mapping.gaussian_map import learning_rates
from activestructure_gym.ranges import check_ranges

# Value of the spherical harmonic of degree 0: change of a colour per change of its coefficient.
HARMONIC = 0.28209479177387814
_RATES = ("mean_rate", "quaternion_rate", "log_scale_rate", "opacity_rate", "color_rate")
_RANGES = {
    **dict.fromkeys(("seed_opacity", "adam_beta1", "adam_beta2"), "(0, 1)"),
    **dict.fromkeys(_RATES, "[0, 1000]"),
    "adam_epsilon": "(0, 1]",
    "prune_opacity": "[0, 1]",
    "max_gaussians": "[1, 100000000]",
}


@dataclass(frozen=True)
class DenseConfig(BaseMapperConfig):
    """Configure a mapper whose steps change every Gaussian, as `torch.optim.Adam` does."""

    seed_opacity: float = 0.5  # opacity of a seed, 0..1
    mean_rate: float = 1e-4  # learning rate of the means, metres per step
    quaternion_rate: float = 1e-3  # learning rate of the quaternions, per step
    log_scale_rate: float = 5e-3  # learning rate of the log scales, per step
    opacity_rate: float = 5e-2  # learning rate of the opacities, logit per step
    color_rate: float = 2.5e-3 * HARMONIC  # learning rate of the colours in 0..1, per step
    adam_beta1: float = 0.9  # decay rate of the first moment [adam]
    adam_beta2: float = 0.999  # decay rate of the second moment [adam]
    adam_epsilon: float = 1e-15  # term that prevents division by 0 [kerbl2023, code]
    centre_depth: bool = True  # whether depth is that of centres instead of ray intersections
    prune_opacity: float = 0.1  # Gaussians with a lower opacity are removed
    max_gaussians: int | None = None  # limits the memory: 176 MB per million Gaussians; None means no limit

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, _RANGES)

    def learning_rates(self) -> np.ndarray:  # [14] float32
        """Return the learning rate of every row of the map's parameters."""
        return learning_rates(
            mean=self.mean_rate,
            quaternion=self.quaternion_rate,
            log_scale=self.log_scale_rate,
            opacity=self.opacity_rate,
            color=self.color_rate,
        )
