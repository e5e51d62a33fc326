"""The constants of Co-SLAM."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from activestructure_gym.mapping.base import BaseMapperConfig
from activestructure_gym.mapping.registry import MAPPERS
from activestructure_gym.ranges import check_ranges

_RANGES = {
    "first_rounds": "[1, 1000]",
    "levels": "[1, 32]",
    "coarsest": "[1, 1024]",
    **dict.fromkeys(("finest_m", "surface_m"), "[0.005, 10]"),
    "log2_entries": "[8, 22]",
    "truncation": "(0, 10]",
    "rays": "[1, 1e6]",
    "least_newest": "[0, 1e6]",
    "ray_share": "(0, 1]",
    **dict.fromkeys(("even_samples", "near_samples"), "[2, 1024]"),
    "color_without_depth": "[0, 1]",
    **dict.fromkeys(("color_weight", "ray_depth_weight", "surface_weight", "free_weight"), "[0, 1e6]"),
    **dict.fromkeys(("decoder_rate", "grid_rate"), "[0, 1000]"),
    "disk_share": "(0, 10]",
    "disk_thickness": "(0, 1000]",
    "disk_opacity": "(0, 1)",
    "max_gaussians": "[1, 100000000]",
}


@dataclass(frozen=True)
class CoSLAMConfig(BaseMapperConfig):
    """Configure Co-SLAM on given poses ([co_slam, code], `configs/Replica`), small enough for a CPU.

    The map is the zero level of the field as disks.
    """

    made_by: ClassVar[str] = "activestructure_gym.mapping.systems.co_slam.mapper:CoSLAMMapper"

    name: str = "co_slam"
    iterations: int = 10  # per keyframe
    first_rounds: int = 20  # times the iterations, for the first keyframe (200 / 10)
    levels: int = 8  # of the hash grid (there 16)
    coarsest: int = 16  # cells per side of the first level
    finest_m: float = 0.05  # metres, cells of the last level along the longest side (there 0.02)
    log2_entries: int = 15  # of a level's table (there 16)
    truncation: float = 0.1  # metres
    rays: int = 512  # of all keyframes in every step (there 2048)
    least_newest: int = 100  # rays of the newest keyframe on top, or ``rays`` over the number of keyframes
    ray_share: float = 0.25  # of a keyframe's pixels are kept (there 0.05 of far larger pictures)
    even_samples: int = 32  # along a ray
    near_samples: int = 11  # more, within the truncation of the measured depth
    color_weight: float = 5.0  # of the squared error of colours
    color_without_depth: float = 0.05  # times the error of a colour without a return
    ray_depth_weight: float = 0.1  # of the squared error of depth
    surface_weight: float = 1000.0  # of the squared error of distances near the surface, m^2
    free_weight: float = 10.0  # of the squared error of distances in free space
    decoder_rate: float = 1e-2  # of the two decoders
    grid_rate: float = 1e-2  # of the features
    surface_m: float = 0.05  # metres between the vertices that the surface is cut out of (there 0.02)
    disk_share: float = 0.8  # in-plane sigma / ``surface_m`` of the disks (own choice)
    disk_thickness: float = 0.1  # sigma along the normal / in-plane sigma (own choice)
    disk_opacity: float = 0.99  # 0..1 (own choice)
    max_gaussians: int | None = None  # a bound on the number of disks; None = no bound

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, _RANGES)


MAPPERS.register("co_slam")(CoSLAMConfig())
