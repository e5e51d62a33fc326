"""The constants of the mapper, and the recipes that are combinations of them."""

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
    "seed_spacing": "[0.01, 1]",  # finer ones fill gaps between pixels with thousands of samples each
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
    """Configure our mapper: posed RGB-D on a CPU budget. The defaults are the recipe ``default``.

    "Row B8" in a comment is a row of the table in docs/notebook/groundwork.md; "measured" is docs/notebook/map.md,
    where held-out views were the judge.
    """

    made_by: ClassVar[str] = "activestructure_gym.mapping.mapper:Mapper"

    name: str = "default"  # of the recipe that these values start from

    # Shape
    isotropic: bool = False  # balls, and one scale per Gaussian, instead of disks on the surface (True: SplaTAM)

    # Seeding
    seed_spacing: float | None = 0.045  # metres from seen surface to a mean, at most; None: SplaTAM's rule (measured)
    seed_pixels: float = 1.2  # the same in pixels where there is texture or an edge (measured)
    texture_contrast: float = 0.02  # 0..1, between neighbouring pixels, above which is texture (measured)
    seed_footprint: float = 1.05  # in-plane sigma / spacing; by SplaTAM's rule / (stride * z / f) (measured)
    border_sigmas: float | None = 1.0  # sigmas between a mean and where its surface ends; None = any (measured)
    seed_thickness: float = 0.1  # sigma along the normal / in-plane sigma (rows B18, B19: irrelevant in .02 .. .3)
    seed_opacity: float = 0.99  # 0..1 (measured: .9 lets 3 % of every wall through, which gains of holes add up)
    min_incidence_cosine: float = 0.05  # below it a depth normal is a depth edge: seed a ball (own choice, 87 degrees)
    coarse_ratio: float | None = 1.6  # Gaussians larger than so many seeds make way for those; None = never (measured)
    # Times a Kinect's axial noise that the seeds' depth is cleaned of (`local_planes`); an env tells its own mapper at
    # least what its sensor makes (measured).
    depth_noise_scale: float = 0.0

    # Seeding by SplaTAM's rule: where the rendering lacks something
    seed_stride: int = 2  # pixels between seeds
    covered_alpha: float = 0.5  # accumulated alpha from which a pixel counts as mapped (SplaTAM; row B20)
    in_front_factor: float = 50.0  # times the median depth error: the map lies behind what is measured (SplaTAM)
    in_front_floor: float = 0.03  # metres, least of that tolerance (own choice; keeps sensor noise from being seeded)

    # Optimisation
    image_weight: float = 0.5  # of the image term (SplaTAM)
    l1_share: float = 0.8  # of L1 in the image term; the rest is 1 - SSIM (3DGS)
    normalised_depth: bool = True  # depth divided by alpha, where alpha > .5; False = as accumulated (False: SplaTAM)
    centre_depth: bool = False  # depth of Gaussians' centres, not of where pixels' rays meet them (True: SplaTAM)
    depth_weight: float = 0.5  # of the depth term, per metre (measured; SplaTAM: 1)
    alpha_weight: float = 0.5  # of the missing opacity where there is a depth: keeps black walls opaque (measured)
    # A seed is where it was measured and has the colour that was measured: what is left to learn is how wide it is, and
    # colours that move as fast as SplaTAM's fit training views at the cost of all others (measured). Opacity is not
    # learnt at all.
    mean_rate: float = 1.5e-4  # metres per step
    quaternion_rate: float = 1e-3  # per step
    log_scale_rate: float = 8e-3  # per step
    opacity_rate: float = 0.0  # logit per step
    color_rate: float = 3e-4  # of the 0..1 range per step
    refine_shapes: bool = False  # refining learns more than colours (measured: held-out views get worse)
    adam_beta1: float = 0.9  # [adam]
    adam_beta2: float = 0.999  # [adam]
    adam_epsilon: float = 1e-15  # [kerbl2023, code]
    adam_reset: bool = False  # a new, bias-corrected Adam for every event (True: SplaTAM; row C12: -.7 dB)

    # View selection
    window: int = 24  # local keyframes an event draws from, the current and the last one included (SplaTAM, Replica)
    overlap_pixels: int = 1600  # of the current frame, projected into the others (SplaTAM)
    overlap_border: float = 1.0 / 60.0  # of the image width, not counted as seen (SplaTAM: 20 of 1200 pixels)
    global_psnr: float = 34.0  # decibel; keyframes below are worth a global visit (ActiveGAMER)
    global_new_share: float = 0.1  # as are those that opened more new pixels than this (ActiveGAMER)
    psnr_refresh: int = 1  # keyframes whose PSNR is measured anew per event, in turn (own choice)

    # Pruning
    prune_opacity: float = 0.005  # Gaussians below go (SplaTAM)
    prune_scale: float = 0.1  # of the scene radius; larger ones go (SplaTAM)
    prune_steps: tuple[int, ...] = (-1,)  # iterations of an event to prune before; -1 = after the last one
    scene_radius: float | None = None  # metres; None = a third of the largest depth measured so far (SplaTAM)
    max_gaussians: int | None = None  # a bound on memory: 176 MB per million; None = as many as the surface needs

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, _RANGES)

    def make(self, rng: np.random.Generator, bounds: np.ndarray, *, depth_noise_scale: float = 0.0) -> MapperProtocol:
        """Return an empty mapper whose seeds allow for at least this depth noise."""
        scale = max(self.depth_noise_scale, depth_noise_scale)
        return super(MapperConfig, replace(self, depth_noise_scale=scale)).make(rng, bounds)

    def learning_rates(self, *, refining: bool = False) -> np.ndarray:  # [14] float32
        """Return the step size of every parameter row, in a mapping event or when only refining."""
        shapes = not refining or self.refine_shapes
        return learning_rates(
            mean=shapes * self.mean_rate,
            quaternion=shapes * self.quaternion_rate,
            log_scale=shapes * self.log_scale_rate,
            opacity=shapes * self.opacity_rate,
            color=self.color_rate,
        )


# What each recipe changes of the defaults below.
_RECIPES: Mapping[str, Mapping[str, Any]] = {
    # Ours: docs/notebook/groundwork.md, "The mapper's recipe", and what was measured since.
    "default": {},
    # SplaTAM-S on given poses with ActiveGAMER's schedule ([splatam, code], [activegamer, code]): the backbone that
    # active reconstruction methods share. Values without a comment are those of SplaTAM's Replica-S configuration.
    "splatam": {
        "isotropic": True,
        "seed_spacing": None,
        "seed_footprint": 1.0,  # one pixel of the image the seeds are taken from
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
        "psnr_refresh": 0,  # a keyframe is judged once, right after its own event (ActiveGAMER)
        "prune_steps": (0, 20),
    },
}

for _name, _changes in _RECIPES.items():
    MAPPERS.register(_name)(MapperConfig(name=_name, **_changes))
