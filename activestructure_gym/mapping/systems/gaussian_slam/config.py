"""Define the configuration of Gaussian-SLAM."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from activestructure_gym.mapping.registry import MAPPERS
from activestructure_gym.mapping.systems.dense_config import DenseConfig
from activestructure_gym.ranges import check_ranges

_RANGES = {
    **dict.fromkeys(("covered_alpha", "l1_share"), "[0, 1]"),
    "in_front_factor": "[0, 1e9]",
    "in_front_floor": "[0, 1000]",
    **dict.fromkeys(("image_weight", "depth_weight", "roundness_weight"), "[0, 1e6]"),
    **dict.fromkeys(("current_share", "submap_seed_share"), "(0, 1]"),
    "submap_edge_share": "[0, 1]",
    "submap_metres": "(0, 1000]",
    "submap_degrees": "(0, 180]",
    "submap_rounds": "[1, 1000]",
    "behind": "[0.9, 1.1]",
    "nearest_seed": "[0, 1]",
}


@dataclass(frozen=True)
class GaussianSLAMConfig(DenseConfig):
    """Configure Gaussian-SLAM with given poses; defaults are those of [gaussian_slam, code], `configs/Replica`.

    Colours are optimised in the second half of a mapping event only. Gaussians are pruned in the middle and at the end.
    """

    made_by: ClassVar[str] = "activestructure_gym.mapping.systems.gaussian_slam.mapper:GaussianSLAMMapper"

    name: str = "gaussian_slam"
    covered_alpha: float = 0.6  # a pixel with at least this accumulated alpha is mapped
    in_front_factor: float = 40.0  # depth tolerance of a mapped pixel, as a factor on the median depth error
    in_front_floor: float = 0.0  # metres, smallest depth tolerance of a mapped pixel
    iterations: int = 20  # optimiser steps per keyframe (100 in the original; own choice, for a CPU)
    image_weight: float = 1.0  # weight of the image term in the loss
    l1_share: float = 0.8  # weight of L1 in the image term; the rest is 1 - SSIM
    depth_weight: float = 1.0  # weight of the depth term in the loss, per metre
    roundness_weight: float = 1.0  # weight of the shape term `roundness` in the loss, per metre
    current_share: float = 0.4  # probability that a step uses the current keyframe; otherwise another of its sub-map
    submap_metres: float = 0.5  # a sub-map ends beyond this distance from its first pose, metres
    submap_degrees: float = 50.0  # a sub-map ends if an Euler angle to its first pose exceeds this, degrees
    submap_rounds: int = 2  # factor on the iterations of the first keyframe of a sub-map (10 in the original)
    # Share of the first keyframe's pixels with a seed (600,000 of 816,000; own choice, for a CPU).
    submap_seed_share: float = 0.25
    submap_edge_share: float = 0.06  # additional share of its pixels, drawn by image gradient (50,000 of 816,000)
    behind: float = 1.005  # depth of a seed, as a factor on the measured depth
    nearest_seed: float = 3.2e-4  # metres, smallest distance between a seed and a Gaussian of the sub-map (1e-7 m^2)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, _RANGES)


MAPPERS.register("gaussian_slam")(GaussianSLAMConfig())
