"""Define the configuration of Co-SLAM."""

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
    """Configure Co-SLAM with given poses ([co_slam, code], `configs/Replica`), reduced for a CPU.

    Numbers in brackets are the values of the original. The map is the surface of the neural field, as disks.
    """

    made_by: ClassVar[str] = "activestructure_gym.mapping.systems.co_slam.mapper:CoSLAMMapper"

    name: str = "co_slam"
    iterations: int = 10  # optimiser steps per keyframe
    first_rounds: int = 20  # factor on the steps of the first keyframe (200 / 10)
    levels: int = 8  # resolution levels of the hash grid (16)
    coarsest: int = 16  # cells per side of the coarsest level
    finest_m: float = 0.05  # metres, cell size of the finest level along the longest side (0.02)
    log2_entries: int = 15  # logarithm to base 2 of the table entries of a level (16)
    truncation: float = 0.1  # metres, truncation distance of the signed distance
    rays: int = 512  # rays per step, from all keyframes (2048)
    # Smallest number of additional rays per step from the newest keyframe; else ``rays`` / keyframes.
    least_newest: int = 100
    ray_share: float = 0.25  # share of a keyframe's pixels that are stored as rays (0.05 of larger images)
    even_samples: int = 32  # samples per ray, evenly over the box
    near_samples: int = 11  # additional samples per ray, within ``truncation`` of the measured depth
    color_weight: float = 5.0  # weight of the squared colour error
    color_without_depth: float = 0.05  # factor on the colour error of pixels without a return
    ray_depth_weight: float = 0.1  # weight of the squared depth error, per m^2
    surface_weight: float = 1000.0  # weight of the squared distance error near the surface, per m^2
    free_weight: float = 10.0  # weight of the squared distance error in free space
    decoder_rate: float = 1e-2  # learning rate of the two decoders
    grid_rate: float = 1e-2  # learning rate of the features of the hash grid
    surface_m: float = 0.05  # metres, spacing of the grid for surface extraction (0.02)
    disk_share: float = 0.8  # in-plane sigma of a disk / ``surface_m`` (own choice)
    disk_thickness: float = 0.1  # sigma of a disk along its normal / in-plane sigma (own choice)
    disk_opacity: float = 0.99  # opacity of a disk, 0..1 (own choice)
    max_gaussians: int | None = None  # largest number of disks; None means no limit

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, _RANGES)


MAPPERS.register("co_slam")(CoSLAMConfig())
