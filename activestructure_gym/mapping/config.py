"""Define the constants of our mapper, and the recipes that combine them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from activestructure_gym.mapping.base import BaseMapperConfig, MapperProtocol
from activestructure_gym.mapping.gaussian_map import learning_rates
from activestructure_gym.mapping.registry import MAPPERS
from activestructure_gym.ranges import check_ranges

_RANGES = {
    "seed_stride": "[1, 1024]",
    "seed_spacing": "[0.01, 1]",  # a smaller spacing would create thousands of samples per pixel
    "seed_pixels": "[0.5, 1000]",
    "depth_noise_scale": "[0, 1000]",
    **dict.fromkeys(("seed_footprint", "seed_thickness"), "(0, 1000]"),
    "border_sigmas": "(0, 100]",
    "coarse_ratio": "[1, 1e6]",
    **dict.fromkeys(("seed_opacity", "adam_beta1", "adam_beta2"), "(0, 1)"),
    **dict.fromkeys(("covered_alpha", "min_incidence_cosine", "overlap_border", "global_new_share", "l1_share",
                     "prune_opacity", "texture_contrast"), "[0, 1]"),
    "in_front_factor": "[0, 1e9]",
    "in_front_floor": "[0, 1000]",
    "psnr_refresh": "[0, 100000]",
    **dict.fromkeys(("image_weight", "depth_weight", "alpha_weight"), "[0, 1e6]"),
    **dict.fromkeys(("mean_rate", "quaternion_rate", "log_scale_rate", "opacity_rate", "color_rate"), "[0, 1000]"),
    "scene_radius": "(0, 100000]",
    "adam_epsilon": "(0, 1]",
    "window": "[1, 100000]",
    "overlap_pixels": "[1, 1e8]",
    "global_psnr": "[0, 1000]",
    "prune_scale": "(0, 1e9]",
    "prune_steps": "[-1, 100000]",
    "max_gaussians": "[1, 100000000]",
}  # fmt: skip


@dataclass(frozen=True)
class MapperConfig(BaseMapperConfig):
    """Configure our mapper: posed RGB-D frames on a CPU. The defaults are the recipe ``default``.

    "Row B8" in a comment is a row of the table in docs/notebook/groundwork.md. "Measured" refers to
    docs/notebook/map.md, which compares held-out views.
    """

    made_by: ClassVar[str] = "activestructure_gym.mapping.mapper:Mapper"

    name: str = "default"  # of the recipe that these values are based on

    # Shape
    isotropic: bool = False  # balls with one scale instead of disks on the surface (SplaTAM: True)

    # Seeding
    seed_spacing: float | None = 0.045  # metres from surface point to mean, at most; None: SplaTAM's rule (measured)
    seed_pixels: float = 1.2  # the same in pixels, at texture and edges (measured)
    texture_contrast: float = 0.02  # 0..1, smallest difference of neighbouring pixels that is texture (measured)
    seed_footprint: float = 1.05  # in-plane sigma / spacing; with SplaTAM's rule / (stride * z / f) (measured)
    border_sigmas: float | None = 1.0  # sigmas from a mean to the boundary of its surface; None = no limit (measured)
    seed_thickness: float = 0.1  # sigma along the normal / in-plane sigma (rows B18, B19: no effect in 0.02..0.3)
    seed_opacity: float = 0.99  # 0..1 (measured: with 0.9 walls transmit 3 %, which gains of holes add up)
    min_incidence_cosine: float = 0.05  # a smaller cosine is a depth edge: seed a ball (own choice, 87 degrees)
    coarse_ratio: float | None = 1.6  # replace Gaussians larger than this multiple of a seed; None = never (measured)
    # Depth noise that `local_planes` removes before seeding, as a factor on the axial noise of a Kinect (measured). An
    # environment raises it to the noise of its sensor.
    depth_noise_scale: float = 0.0

    # Seeding by SplaTAM's rule: pixels missing in the rendered map
    seed_stride: int = 2  # pixels between seeds
    covered_alpha: float = 0.5  # smallest accumulated alpha of a mapped pixel (SplaTAM; row B20)
    in_front_factor: float = 50.0  # tolerance of the depth of a mapped pixel, as a factor on the median error (SplaTAM)
    in_front_floor: float = 0.03  # metres, smallest tolerance (own choice; sensor noise is not seeded)

    # Optimisation
    image_weight: float = 0.5  # of the image term (SplaTAM)
    l1_share: float = 0.8  # weight of L1 in the image term; the rest is 1 - SSIM (3DGS)
    normalised_depth: bool = True  # depth divided by alpha where alpha > 0.5; False = accumulated (SplaTAM: False)
    centre_depth: bool = False  # depth of centres instead of ray intersections (SplaTAM: True)
    depth_weight: float = 0.5  # of the depth term, per metre (measured; SplaTAM: 1)
    alpha_weight: float = 0.5  # weight of missing opacity at a depth return; keeps black walls opaque (measured)
    # Seeds have measured positions and colours, so mainly their scales are optimised. SplaTAM's colour rate improves
    # training views and makes held-out views worse (measured). Opacity is constant.
    mean_rate: float = 1.5e-4  # metres per step
    quaternion_rate: float = 1e-3  # per step
    log_scale_rate: float = 8e-3  # per step
    opacity_rate: float = 0.0  # logit per step
    color_rate: float = 3e-4  # of the 0..1 range per step
    refine_shapes: bool = False  # refinement changes more than colours (measured: held-out views get worse)
    adam_beta1: float = 0.9  # [adam]
    adam_beta2: float = 0.999  # [adam]
    adam_epsilon: float = 1e-15  # [kerbl2023, code]
    adam_reset: bool = False  # zero moments and bias correction in every event (SplaTAM: True; row C12: −0.7 dB)

    # View selection
    window: int = 24  # local keyframes of an event, including the current and the previous one (SplaTAM, Replica)
    overlap_pixels: int = 1600  # pixels of the current frame projected into other keyframes (SplaTAM)
    overlap_border: float = 1.0 / 60.0  # share of the image width without overlap test (SplaTAM: 20 of 1200 pixels)
    global_psnr: float = 34.0  # dB; keyframes with a lower PSNR are global keyframes (ActiveGAMER)
    global_new_share: float = 0.1  # so are keyframes with a larger share of new pixels (ActiveGAMER)
    psnr_refresh: int = 1  # keyframes per event whose PSNR is measured again, in turn (own choice)

    # Pruning
    prune_opacity: float = 0.005  # Gaussians with a lower opacity are removed (SplaTAM)
    prune_scale: float = 0.1  # share of the scene radius; larger Gaussians are removed (SplaTAM)
    prune_steps: tuple[int, ...] = (-1,)  # iterations of an event with pruning before them; -1 = after the last
    scene_radius: float | None = None  # metres; None = 1/3 of the largest measured depth (SplaTAM)
    max_gaussians: int | None = None  # limits memory: 176 MB per million; None = no limit

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, _RANGES)

    def make(self, rng: np.random.Generator, bounds: np.ndarray, *, depth_noise_scale: float = 0.0) -> MapperProtocol:
        """Return an empty mapper that removes at least this depth noise before seeding."""
        scale = max(self.depth_noise_scale, depth_noise_scale)
        return super(MapperConfig, replace(self, depth_noise_scale=scale)).make(rng, bounds)

    def learning_rates(self, *, refining: bool = False) -> np.ndarray:  # [14] float32
        """Return the step size of every parameter row, in a mapping event or in a refinement."""
        shapes = not refining or self.refine_shapes
        return learning_rates(
            mean=shapes * self.mean_rate,
            quaternion=shapes * self.quaternion_rate,
            log_scale=shapes * self.log_scale_rate,
            opacity=shapes * self.opacity_rate,
            color=self.color_rate,
        )


# Differences of each recipe from the defaults of `MapperConfig`.
_RECIPES: Mapping[str, Mapping[str, Any]] = {
    # Our own: docs/notebook/groundwork.md, "The mapper's recipe", and later measurements.
    "default": {},
    # SplaTAM-S with given poses and ActiveGAMER's schedule ([splatam, code], [activegamer, code]), the common mapper of
    # active reconstruction methods. Values without a comment are from SplaTAM's Replica-S configuration.
    "splatam": {
        "isotropic": True,
        "seed_spacing": None,
        "seed_footprint": 1.0,  # one pixel of the image with the seeds
        "seed_opacity": 0.5,
        "normalised_depth": False,
        "centre_depth": True,
        "in_front_floor": 0.0,
        "coarse_ratio": None,
        "iterations": 15,
        "depth_weight": 1.0,
        "alpha_weight": 0.0,
        "adam_reset": True,
        "refine_shapes": True,
        "mean_rate": 1e-4,
        "quaternion_rate": 1e-3,
        "log_scale_rate": 1e-3,
        "opacity_rate": 5e-2,
        "color_rate": 2.5e-3,
        "window": 32,
        "psnr_refresh": 0,  # the PSNR of a keyframe is measured once, after its event (ActiveGAMER)
        "prune_steps": (0, 20),
    },
}

for _name, _changes in _RECIPES.items():
    MAPPERS.register(_name)(MapperConfig(name=_name, **_changes))
