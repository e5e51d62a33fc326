"""Define the configuration of the default mapper, and the recipes: named sets of its values."""

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
    "seed_columns": "[1, 65536]",
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
    """Configure the default mapper, which maps posed RGB-D frames on a CPU.

    The default values are the recipe ``default``. "Measured" refers to docs/notebook/map.md and
    docs/notebook/lab_notes.md.
    """

    made_by: ClassVar[str] = "activestructure_gym.mapping.mapper:Mapper"

    name: str = "default"  # name of the recipe on which these values are based

    # Shape of the Gaussians

    # Whether Gaussians are balls with one scale instead of disks on the surface (SplaTAM: True).
    isotropic: bool = False

    # Seeding

    # Metres, largest distance from a surface point to a mean; None uses SplaTAM's rule (measured).
    seed_spacing: float | None = 0.045
    seed_pixels: float = 1.2  # the same distance in pixels, at texture and edges (measured)
    # Smallest colour difference of neighbouring pixels that counts as texture, 0..1 (measured).
    texture_contrast: float = 0.02
    # In-plane sigma / spacing; with SplaTAM's rule, in-plane sigma / (stride z / f) (measured).
    seed_footprint: float = 1.05
    # Disks are narrowed until a boundary of the surface is this many sigmas from the mean; None means never (measured).
    border_sigmas: float | None = 1.0
    seed_thickness: float = 0.1  # sigma along the normal / in-plane sigma (measured: no effect in 0.02..0.3)
    # Opacity of a seed, 0..1 (measured: with 0.9, walls transmit 3 %, which adds up in hole features).
    seed_opacity: float = 0.99
    # Seeds with a smaller cosine between normal and line of sight are balls (own choice: 87 degrees, a depth edge).
    min_incidence_cosine: float = 0.05
    # Gaussians wider than a new seed by this factor are replaced; None means never (measured).
    coarse_ratio: float | None = 1.6
    # Depth noise that is removed before seeding (`local_planes`), as a factor on the axial noise of a Kinect
    # (measured). An environment raises the value to the noise of its sensor.
    depth_noise_scale: float = 0.0

    # Seeding by SplaTAM's rule: at pixels missing in the rendered map
    # Seeds across the width of an image, up to rounding; at most one per pixel (SplaTAM-S: 600 of 1200 pixels).
    seed_columns: int = 600
    covered_alpha: float = 0.5  # a pixel with at least this accumulated alpha is mapped (SplaTAM)
    in_front_factor: float = 50.0  # depth tolerance of a mapped pixel, as a factor on the median depth error (SplaTAM)
    # Metres, smallest depth tolerance of a mapped pixel (own choice: no seeds from sensor noise).
    in_front_floor: float = 0.03

    # Optimisation
    image_weight: float = 0.5  # weight of the image term in the loss (SplaTAM)
    l1_share: float = 0.8  # weight of L1 in the image term; the rest is 1 - SSIM (3DGS)
    # Whether depth is divided by alpha where alpha > 0.5; False is accumulated depth (SplaTAM: False).
    normalised_depth: bool = True
    centre_depth: bool = False  # whether depth is that of centres instead of ray intersections (SplaTAM: True)
    depth_weight: float = 0.5  # weight of the depth term in the loss, per metre (measured; SplaTAM: 1)
    alpha_weight: float = 0.5  # weight of missing opacity at a depth return; it keeps black walls opaque (measured)
    # Seeds have measured positions and colours, so mainly their scales are optimised. SplaTAM's learning rate for
    # colours improves training views and makes held-out views worse (measured). Opacities are constant.
    mean_rate: float = 1.5e-4  # learning rate of the means, metres per step
    quaternion_rate: float = 1e-3  # learning rate of the quaternions, per step
    log_scale_rate: float = 8e-3  # learning rate of the log scales, per step
    opacity_rate: float = 0.0  # learning rate of the opacities, logit per step
    color_rate: float = 3e-4  # learning rate of the colours in 0..1, per step
    refine_shapes: bool = False  # whether refinement changes more than colours (measured: held-out views get worse)
    adam_beta1: float = 0.9  # decay rate of the first moment [adam]
    adam_beta2: float = 0.999  # decay rate of the second moment [adam]
    adam_epsilon: float = 1e-15  # term that prevents division by 0 [kerbl2023, code]
    # Whether every event starts Adam anew, with bias correction (SplaTAM: True; measured: −0.7 dB).
    adam_reset: bool = False

    # View selection
    window: int = 24  # local keyframes of an event, including the newest two (SplaTAM, Replica)
    overlap_pixels: int = 1600  # pixels of the new frame projected into other keyframes to find overlap (SplaTAM)
    # Share of the image width at each border that is not tested for overlap (SplaTAM: 20 of 1200 pixels).
    overlap_border: float = 1.0 / 60.0
    global_psnr: float = 34.0  # dB; keyframes with a lower PSNR are global keyframes (ActiveGAMER)
    global_new_share: float = 0.1  # keyframes with a larger share of new pixels are global keyframes too (ActiveGAMER)
    psnr_refresh: int = 1  # keyframes per event, besides the new one, whose PSNR is measured again in turn (own choice)
    psnr_of_returns: bool = False  # whether pixels without a depth return count as rendered well (ActiveGAMER: True)

    # Pruning
    prune_opacity: float = 0.005  # Gaussians with a lower opacity are removed (SplaTAM)
    prune_scale: float = 0.1  # Gaussians larger than this share of the scene radius are removed (SplaTAM)
    # Steps of an event before which Gaussians are pruned; -1 means after the last step.
    prune_steps: tuple[int, ...] = (-1,)
    scene_radius: float | None = None  # metres; None means a third of the largest measured depth (SplaTAM)
    max_gaussians: int | None = None  # limits the memory: 176 MB per million Gaussians; None means no limit

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, _RANGES)

    def make(self, rng: np.random.Generator, bounds: np.ndarray, *, depth_noise_scale: float = 0.0) -> MapperProtocol:
        """Return a new mapper that removes at least the depth noise ``depth_noise_scale`` before seeding.

        See `BaseMapperConfig`.
        """
        scale = max(self.depth_noise_scale, depth_noise_scale)
        return super(MapperConfig, replace(self, depth_noise_scale=scale)).make(rng, bounds)

    def learning_rates(self, *, refining: bool = False) -> np.ndarray:  # [14] float32
        """Return the learning rate of every row of the map's parameters, in a mapping event or in a refinement."""
        shapes = not refining or self.refine_shapes
        return learning_rates(
            mean=shapes * self.mean_rate,
            quaternion=shapes * self.quaternion_rate,
            log_scale=shapes * self.log_scale_rate,
            opacity=shapes * self.opacity_rate,
            color=self.color_rate,
        )


# Recipes: differences from the default values of `MapperConfig`.
_RECIPES: Mapping[str, Mapping[str, Any]] = {
    # Own recipe: docs/notebook/lab_notes.md, and later measurements.
    "default": {},
    # SplaTAM-S with given poses and ActiveGAMER's schedule ([splatam, code], [activegamer, code]). Many active
    # reconstruction methods use this mapper. Values without a comment are from SplaTAM's Replica-S configuration.
    "splatam": {
        "isotropic": True,
        "seed_spacing": None,
        "seed_footprint": 1.0,  # one pixel of the seeded image
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
        # Mapping measures the PSNR of a keyframe once, after its own event (ActiveGAMER). An episode measures the worst
        # again for revisits, and after a stay.
        "psnr_refresh": 0,
        "psnr_of_returns": True,
        "prune_steps": (0, 20),
    },
}

for _name, _changes in _RECIPES.items():
    MAPPERS.register(_name)(MapperConfig(name=_name, **_changes))
