"""Configure the voxel grid, and compute its shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.ranges import MAX_COORDINATE_M, check_ranges

# A larger grid would need gigabytes. Its usual cause is a wrong unit, such as a mesh in millimetres.
_MAX_VOXELS = 60_000_000
_RANGES = {
    "voxel_size": "[0.0001, 100]",
    "max_range": "(0, 1000]",
    **dict.fromkeys(("margin", "margin_growth", "unknown_slack"), "[0, 100]"),
    **dict.fromkeys(("thinnest", "truncation"), "(0, 100]"),
    "max_miss_chance": "[0, 1)",
    **dict.fromkeys(("hit_gain", "hit_ceiling"), "[1, 30000]"),
    "max_weight": "(0, 1e6]",
}


@dataclass(frozen=True)
class VolumeConfig:
    """Configure the resolution and the safety margins of the voxel grid."""

    voxel_size: float = 0.1
    """Side length of a voxel, metres. (0.1 m costs 5 to 10 times less than 0.05 m, and 0.8 m doors remain passable.)"""
    max_range: float = 5.0
    """Largest depth used, metres. Beyond it depth noise exceeds half a voxel (Kinect: 4 cm at 5 m)."""
    margin: float = 0.02
    """Metres by which a ray must end behind a voxel to prove it free, at depth 0."""
    margin_growth: float = 0.006
    """Growth of the margin, metres per square metre of depth: 3 sigma of Kinect noise (0.0019 z^2, [nguyen2012])."""
    thinnest: float = 0.03
    """Width in metres of the thinnest structure (lamp pole, chair leg) that rays must not miss."""
    max_miss_chance: float = 0.05
    """A voxel is free if the probability that all views missed such a structure is at most this.

    0 = near views only.
    """
    hit_gain: int = 5
    """Number of observations of a voxel as free that cancel one hit (noise). Fewer would erase very thin structures."""
    hit_ceiling: int = 50
    """Largest value of the hit counter of a voxel, in observations as free, so that wrong hits can be cleared."""
    unknown_slack: float = 0.05
    """Metres by which unknown space may be closer to the agent than an occupied voxel.

    Without it, a camera with a field of view of 60 degrees hardly leaves its start, since the observed cone is too
    narrow there. Measured in 100 frames of random exploration: 1.6 m of path without it, 6.6 m with it.
    """
    truncation: float = 0.3
    """Truncation distance of the TSDF in metres; at least 3 voxels are used."""
    max_weight: float = 64.0
    """Number of observations of a voxel after which its TSDF value becomes a moving average."""

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES)
        if self.hit_gain > self.hit_ceiling:
            raise InputError(f"hit_ceiling must be at least hit_gain ({self.hit_gain}), got {self.hit_ceiling}")


def grid_shape(bounds: np.ndarray, voxel_size: float) -> tuple[int, int, int]:
    """Return the number of voxels along each axis of a grid over ``bounds`` [2, 3] in metres, with a border of one.

    Raises `InputError` for too many voxels or a scene too far from the origin.
    """
    away = float(np.abs(bounds).max())
    if away > MAX_COORDINATE_M:
        raise InputError(
            f"the scene is {away:,.0f} m from the origin, and at most {MAX_COORDINATE_M:,.0f} m is allowed: move it"
        )
    extent = np.asarray(bounds[1], dtype=np.float64) - bounds[0]
    cells = np.ceil(extent / voxel_size - 1e-9) + 2.0
    if cells.prod() > _MAX_VOXELS:
        sides = " x ".join(f"{side:.0f}" for side in extent)
        raise InputError(
            f"expected a workspace of building size, got {sides} m: {cells.prod():.1e} voxels of {voxel_size} m; "
            "check the units of the mesh, or raise voxel_size"
        )
    return int(cells[0]), int(cells[1]), int(cells[2])
