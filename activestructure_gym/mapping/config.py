"""The constants of the mapper, and the recipes that are combinations of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from activestructure_gym.errors import InputError, unknown_name
from activestructure_gym.mapping.gaussian_map import COLOR, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, ROWS
from activestructure_gym.mapping.tracking import TrackingConfig
from activestructure_gym.ranges import check_ranges
from activestructure_gym.splatting.backends import BACKENDS, Backend

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
    **dict.fromkeys(("iterations", "psnr_refresh"), "[0, 100000]"),
    **dict.fromkeys(("image_weight", "depth_weight", "alpha_weight"), "[0, 1e6]"),
    **dict.fromkeys(("mean_rate", "quaternion_rate", "log_scale_rate", "opacity_rate", "color_rate"), "[0, 1000]"),
    "keyframe_reduction": "[1, 64]",
    "scene_radius": "(0, 100000]",
    "adam_epsilon": "(0, 1]",
    "window": "[1, 100000]",
    "overlap_pixels": "[1, 1e8]",
    "global_psnr": "[0, 1000]",
    "prune_scale": "(0, 1e9]",
    "prune_steps": "[-1, 100000]",
    "max_gaussians": "[1, 100000000]",
}  # fmt: skip

_RANGES_OF_MONOGS = {
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
_RANGES_OF_GAUSSIAN_SLAM = {
    "roundness_weight": "[0, 1e6]",
    **dict.fromkeys(("current_share", "submap_seed_share"), "(0, 1]"),
    "submap_edge_share": "[0, 1]",
    "submap_metres": "(0, 1000]",
    "submap_degrees": "(0, 180]",
    "submap_rounds": "[1, 1000]",
    "behind": "[0.9, 1.1]",
    "nearest_seed": "[0, 1]",
}
_RANGES_OF_CO_SLAM = {
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
}

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


@dataclass(frozen=True)
class MapperConfig:
    """The mapper: posed RGB-D on a CPU budget. The defaults are the recipe ``default``, others stand in `MAPPERS`.

    "Row B8" in a comment is a row of the table in docs/notebook/groundwork.md; "measured" is docs/notebook/map.md,
    where held-out views were the judge.
    """

    name: str = "default"  # of the recipe these values started from, a key of `MAPPERS`
    backend: Backend = "cpu"  # who draws the map and steps it: the kernels, or torch by gsplat on CUDA or the reference

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
    iterations: int = 5  # per observed frame (row C15; 15 for quality)
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
    keyframe_reduction: int = 1  # keyframes are kept with so many times fewer pixels a side; seeds come of all pixels
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

    tracking: TrackingConfig = field(default_factory=TrackingConfig)  # of the pose of every keyframe; off by default

    def __post_init__(self) -> None:
        if self.name not in _NAMES:
            raise unknown_name("mapper", self.name, _NAMES)
        if not isinstance(self, _SYSTEMS.get(self.name, MapperConfig)):
            raise InputError(f"mapper '{self.name}' has fields of its own: start from MAPPERS['{self.name}']")
        if self.backend not in BACKENDS:
            raise unknown_name("mapper backend", self.backend, BACKENDS)
        check_ranges(self, _RANGES)

    def learning_rates(self, *, refining: bool = False) -> np.ndarray:  # [14] float32
        """Step size of every parameter row, in a mapping event or when only refining."""
        rates = np.zeros(ROWS, dtype=np.float32)
        rates[COLOR] = self.color_rate
        if refining and not self.refine_shapes:
            return rates
        rates[MEAN] = self.mean_rate
        rates[QUATERNION] = self.quaternion_rate
        rates[LOG_SCALE] = self.log_scale_rate
        rates[OPACITY_LOGIT] = self.opacity_rate
        return rates


HARMONIC = 0.28209479177387814  # of degree 0: where colours are learnt as its factor, a step of it is a step of colour


@dataclass(frozen=True)
class MonoGSConfig(MapperConfig):
    """MonoGS with depth, on given poses ([monogs, code], `configs/rgbd`): `activestructure_gym.mapping.monogs`.

    Fields of `MapperConfig` about seeding by spacing and view selection mean nothing here.
    """

    name: str = "monogs"
    seed_spacing: float | None = None
    seed_opacity: float = 0.5
    iterations: int = 10  # per keyframe, each over the whole window (with a process of its own for mapping)
    mean_rate: float = 9.6e-4  # metres per step: 1.6e-4 times the extent of 6 m
    mean_rate_end: float = 9.6e-6  # metres per step, after ``mean_rate_steps``
    mean_rate_steps: int = 30_000  # over which the rate of the means falls from one to the other
    quaternion_rate: float = 1e-3
    log_scale_rate: float = 6e-3
    opacity_rate: float = 5e-2
    color_rate: float = 2.5e-3 * HARMONIC
    refine_shapes: bool = True
    normalised_depth: bool = False
    centre_depth: bool = True
    window: int = 10  # keyframes that every step renders
    prune_opacity: float = 0.7  # Gaussians below go, when they are judged
    psnr_refresh: int = 0
    color_share: float = 0.95  # of the colour term in the loss; the rest is depth, in metres
    roundness_weight: float = 10.0  # of the mean deviation of an axis from a Gaussian's mean axis, metres
    seed_share: float = 0.125  # of a keyframe's pixels (there 1/64 of 1200 x 680, more than a picture here has)
    first_seed_share: float = 0.25  # of the first keyframe's pixels (there 1/32)
    point_size: float = 0.05  # metres, at most; and times the median depth
    first_rounds: int = 7  # times the iterations, for the first keyframe (1050 / 150)
    random_views: int = 2  # keyframes outside of the window, in every step
    least_overlap: float = 0.4  # of what two keyframes see: below, the older one leaves the window
    prune_every: int = 150  # steps
    prune_after: int = 50  # steps that a Gaussian took part in before it is judged, and of the first judgement
    prune_size: float = 0.6  # metres, sigma: a tenth of the extent of 6 m

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, _RANGES_OF_MONOGS)


@dataclass(frozen=True)
class GaussianSLAMConfig(MapperConfig):
    """Gaussian-SLAM on given poses ([gaussian_slam, code], `configs/Replica`): `mapping.gaussian_slam`.

    Fields of `MapperConfig` about seeding by spacing and view selection mean nothing here.
    """

    name: str = "gaussian_slam"
    seed_spacing: float | None = None
    seed_opacity: float = 0.5
    covered_alpha: float = 0.6
    in_front_factor: float = 40.0
    in_front_floor: float = 0.0
    iterations: int = 20  # per keyframe (there 100; own choice, for a CPU)
    image_weight: float = 1.0
    l1_share: float = 0.8
    depth_weight: float = 1.0
    normalised_depth: bool = False
    centre_depth: bool = True
    mean_rate: float = 1e-4
    quaternion_rate: float = 1e-3
    log_scale_rate: float = 5e-3
    opacity_rate: float = 5e-2
    color_rate: float = 2.5e-3 * HARMONIC  # in the second half of an event; in the first one colours stay
    refine_shapes: bool = True
    adam_reset: bool = True
    prune_opacity: float = 0.1  # in the middle and at the end of an event
    psnr_refresh: int = 0
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
        check_ranges(self, _RANGES_OF_GAUSSIAN_SLAM)


@dataclass(frozen=True)
class CoSLAMConfig(MapperConfig):
    """Co-SLAM on given poses ([co_slam, code], `configs/Replica`), small enough for a CPU: `mapping.co_slam`.

    The map is the field's zero level as disks: of `MapperConfig`, fields about seeding, losses and pruning of Gaussians
    mean nothing here.
    """

    name: str = "co_slam"
    seed_spacing: float | None = None
    iterations: int = 10  # per keyframe
    psnr_refresh: int = 0
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

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, _RANGES_OF_CO_SLAM)


# Mappers with an optimiser or a map of their own, which more fields are needed for.
_SYSTEMS: dict[str, type[MapperConfig]] = {
    "monogs": MonoGSConfig,
    "gaussian_slam": GaussianSLAMConfig,
    "co_slam": CoSLAMConfig,
}
_NAMES = (*_RECIPES, *_SYSTEMS)

MAPPERS: dict[str, MapperConfig] = {
    **{name: MapperConfig(name=name, **changes) for name, changes in _RECIPES.items()},
    **{name: kind() for name, kind in _SYSTEMS.items()},
}
