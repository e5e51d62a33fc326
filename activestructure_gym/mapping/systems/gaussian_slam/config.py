"""Define the constants of Gaussian-SLAM."""

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
    """Configure Gaussian-SLAM with given poses ([gaussian_slam, code], `configs/Replica`).

    Colours are learnt in the second half of an event only; pruning is in the middle and at the end of it.
    """

    made_by: ClassVar[str] = "activestructure_gym.mapping.systems.gaussian_slam.mapper:GaussianSLAMMapper"

    name: str = "gaussian_slam"
    covered_alpha: float = 0.6  # smallest accumulated alpha of a mapped pixel
    in_front_factor: float = 40.0  # tolerance of the depth of a mapped pixel, as a factor on the median error
    in_front_floor: float = 0.0  # metres, smallest tolerance
    iterations: int = 20  # per keyframe (100 in the original; own choice, for a CPU)
    image_weight: float = 1.0  # weight of the image term
    l1_share: float = 0.8  # weight of L1 in the image term; the rest is 1 - SSIM
    depth_weight: float = 1.0  # weight of the depth term, per metre
    roundness_weight: float = 1.0  # weight of `roundness`, per metre
    current_share: float = 0.4  # share of steps on the current keyframe; the others use keyframes of its sub-map
    submap_metres: float = 0.5  # largest distance from the first pose of a sub-map
    submap_degrees: float = 50.0  # the same, for each of the three Euler angles
    submap_rounds: int = 2  # factor on the iterations of the first keyframe of a sub-map (10 in the original)
    submap_seed_share: float = 0.25  # share of its pixels with a seed (600,000 of 816,000; own choice, for a CPU)
    submap_edge_share: float = 0.06  # additional share, drawn by image gradient (50,000 of 816,000)
    behind: float = 1.005  # depth of a seed, as a factor on the measured depth
    nearest_seed: float = 3.2e-4  # metres, smallest distance of a seed to a Gaussian of the sub-map (1e-7 m^2)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, _RANGES)


MAPPERS.register("gaussian_slam")(GaussianSLAMConfig())
