"""Define the common constants of systems with Adam on every Gaussian."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.mapping.base import BaseMapperConfig
from activestructure_gym.mapping.gaussian_map import learning_rates
from activestructure_gym.ranges import check_ranges

HARMONIC = 0.28209479177387814  # spherical harmonic of degree 0: colour change per change of its coefficient
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
    """Configure a mapper whose steps change every Gaussian, as torch's Adam does."""

    seed_opacity: float = 0.5  # 0..1
    mean_rate: float = 1e-4  # metres per step
    quaternion_rate: float = 1e-3  # per step
    log_scale_rate: float = 5e-3  # per step
    opacity_rate: float = 5e-2  # logit per step
    color_rate: float = 2.5e-3 * HARMONIC  # of the 0..1 range per step
    adam_beta1: float = 0.9  # [adam]
    adam_beta2: float = 0.999  # [adam]
    adam_epsilon: float = 1e-15  # [kerbl2023, code]
    centre_depth: bool = True  # depth of centres instead of ray intersections
    prune_opacity: float = 0.1  # Gaussians with a lower opacity are removed
    max_gaussians: int | None = None  # limits memory: 176 MB per million; None = no limit

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, _RANGES)

    def learning_rates(self) -> np.ndarray:  # [14] float32
        """Return the step size of every parameter row."""
        return learning_rates(
            mean=self.mean_rate,
            quaternion=self.quaternion_rate,
            log_scale=self.log_scale_rate,
            opacity=self.opacity_rate,
            color=self.color_rate,
        )
