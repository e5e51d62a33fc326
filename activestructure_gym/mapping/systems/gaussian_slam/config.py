"""The constants of Gaussian-SLAM."""

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
    """Configure Gaussian-SLAM on given poses ([gaussian_slam, code], `configs/Replica`).

    Colours are learnt in the second half of an event alone; pruning is in its middle and at its end.
    """

    made_by: ClassVar[str] = "activestructure_gym.mapping.systems.gaussian_slam.mapper:GaussianSLAMMapper"

    name: str = "gaussian_slam"
    covered_alpha: float = 0.6  # accumulated alpha from which a pixel counts as mapped
    in_front_factor: float = 40.0  # times the median depth error: the map lies behind the measurement
    in_front_floor: float = 0.0  # metres, least of that tolerance
    iterations: int = 20  # per keyframe (there 100; own choice, for a CPU)
    image_weight: float = 1.0  # of the image term
    l1_share: float = 0.8  # of L1 in the image term; the rest is 1 - SSIM
    depth_weight: float = 1.0  # of the depth term, per metre
    roundness_weight: float = 1.0  # of the mean deviation of an axis from a Gaussian's mean axis, metres
    current_share: float = 0.4  # of the steps look at the current keyframe, the others at those of its sub-map
    submap_metres: float = 0.5  # from the pose a sub-map began at; beyond, the next one begins
    submap_degrees: float = 50.0  # the same, for any of the three Euler angles
    submap_rounds: int = 2  # times the iterations, for the first keyframe of a sub-map (there 10)
    submap_seed_share: float = 0.25  # of its pixels (there 600,000 of 816,000; own choice, for a CPU)
    submap_edge_share: float = 0.06  # as many more, drawn by the size of the picture's gradient (50,000 of 816,000)
    behind: float = 1.005  # times the depth that was measured stand the seeds
    nearest_seed: float = 3.2e-4  # metres to a Gaussian of the sub-map, at least (1e-7 m^2)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, _RANGES)


MAPPERS.register("gaussian_slam")(GaussianSLAMConfig())
