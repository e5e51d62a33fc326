"""Define the configuration of MonoGS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from activestructure_gym.mapping.registry import MAPPERS
from activestructure_gym.mapping.systems.dense_config import DenseConfig
from activestructure_gym.ranges import check_ranges

_RANGES = {
    "window": "[1, 100000]",
    "mean_rate_end": "(0, 1000]",
    "mean_rate_steps": "[1, 1e9]",
    **dict.fromkeys(("color_share", "least_overlap"), "[0, 1]"),
    "roundness_weight": "[0, 1e6]",
    **dict.fromkeys(("seed_share", "first_seed_share"), "(0, 1]"),
    **dict.fromkeys(("point_size", "prune_size"), "(0, 1000]"),
    "first_rounds": "[1, 1000]",
    "random_views": "[0, 1000]",
    **dict.fromkeys(("prune_every", "prune_after"), "[1, 1e6]"),
}


@dataclass(frozen=True)
class MonoGSConfig(DenseConfig):
    """Configure MonoGS with depth and given poses ([monogs, code], `configs/rgbd`)."""

    made_by: ClassVar[str] = "activestructure_gym.mapping.systems.monogs.mapper:MonoGSMapper"

    name: str = "monogs"
    # Optimiser steps per keyframe, each on the whole window (the original's value with a separate mapping process).
    iterations: int = 10
    mean_rate: float = 9.6e-4  # learning rate of the means, metres per step: 1.6e-4 times the scene extent of 6 m
    mean_rate_end: float = 9.6e-6  # learning rate of the means after ``mean_rate_steps``, metres per step
    mean_rate_steps: int = 30_000  # steps over which the rate of the means decreases
    log_scale_rate: float = 6e-3  # learning rate of the log scales, per step
    window: int = 10  # number of keyframes that every step renders
    prune_opacity: float = 0.7  # tested Gaussians with a lower opacity are removed
    color_share: float = 0.95  # weight of the colour term in the loss; the rest is depth, in metres
    roundness_weight: float = 10.0  # weight of the shape term `roundness` in the loss, per metre
    seed_share: float = 0.125  # share of a keyframe's pixels with a seed (1/64 of 1200 x 680 in the original)
    first_seed_share: float = 0.25  # share of the first keyframe's pixels with a seed (1/32 in the original)
    point_size: float = 0.05  # factor in the size of seeds, see `seed_sigmas`
    first_rounds: int = 7  # factor on the steps of the first keyframe (1050 / 150)
    random_views: int = 2  # number of keyframes outside the window that every step renders too
    least_overlap: float = 0.4  # the oldest keyframe with at most this overlap with the newest leaves the window
    prune_every: int = 150  # steps between prunings
    prune_after: int = 50  # steps after insertion before a Gaussian is tested, and step of the first pruning
    # Metres; tested Gaussians with a larger sigma are removed: a tenth of the scene extent of 6 m.
    prune_size: float = 0.6

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, _RANGES)


MAPPERS.register("monogs")(MonoGSConfig())
