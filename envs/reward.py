"""Compute the reward: newly seen ground-truth surface, minus the path length and minus invalid actions.

In a world without ground truth, newly known volume takes the place of newly seen surface.

No other module of the environment reads the ground-truth surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.geometry import PinholeCamera, invert_rigid
from activestructure_gym.geometry.camera import Lens
from activestructure_gym.volume import UNKNOWN, VoxelVolume

MAX_WEIGHT = 1e9  # limit of a weight's magnitude; sums of rewards stay far from overflow


@dataclass(frozen=True)
class RewardConfig:
    """Define the weights of the reward's terms and the test of whether a surface sample is seen."""

    coverage: float = 20.0  # reward per unit of observed surface share (GenNBV and GLEAM use 20 x delta C.R.)
    known_volume: float = 0.4  # reward per newly known cubic metre; only in worlds without ground truth
    path: float = 0.01  # penalty per metre travelled
    invalid: float = 0.05  # penalty for a masked action
    # A sample is seen if its depth and the sensor's differ by less than this, in metres. 0.05 m is also the threshold
    # of the completion ratio (C.R.).
    tolerance_m: float = 0.05
    tolerance_share: float = 0.01  # tolerance added per metre of depth, since a pixel covers more surface far away
    # Use the true depth instead of the measured one. With measured depth, a noisy sensor is rewarded for viewing the
    # same surface repeatedly until its depth agrees by chance.
    noise_free: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.noise_free, bool | np.bool_):
            raise InputError(f"reward noise_free must be True or False, got {short_repr(self.noise_free)}")
        for name, value in vars(self).items():
            if name == "noise_free":
                continue
            is_number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
            if not (is_number and abs(value) < MAX_WEIGHT):
                raise InputError(f"reward {name} must be a number between -1e9 and 1e9, got {short_repr(value)}")
            if name.startswith("tolerance_") and value < 0:
                raise InputError(f"reward {name} must be at least 0, got {value}")


class SurfaceCoverage:
    """Record which samples of the observable surface a keyframe has seen."""

    def __init__(self, points: np.ndarray, config: RewardConfig) -> None:
        """Start with no sample seen; ``points`` is [S, 3] in metres, world."""
        self._points = np.ascontiguousarray(points, dtype=np.float64)  # [S, 3] world
        self._config = config
        self.seen = np.zeros(len(points), dtype=bool)

    @property
    def points(self) -> np.ndarray:  # [S, 3] world
        """Return the samples in metres."""
        return self._points

    @property
    def share(self) -> float:
        """Return the share of samples seen, in 0..1; 1 if there are no samples."""
        return float(np.count_nonzero(self.seen) / len(self.seen)) if len(self.seen) else 1.0

    def add(self, depth: np.ndarray, camera: PinholeCamera, world_from_camera: np.ndarray) -> None:
        """Mark the samples seen in a depth image [H, W] (metres) taken at the true pose [4, 4]."""
        _mark_seen(
            self.seen,
            self._points,
            np.ascontiguousarray(invert_rigid(world_from_camera), dtype=np.float64),
            camera.lens,
            np.ascontiguousarray(depth, dtype=np.float32),
            self._config.tolerance_m,
            self._config.tolerance_share,
        )


def known_volume(volume: VoxelVolume) -> float:  # m^3
    """Return the volume in cubic metres that is known to be free or occupied."""
    return float((volume.state != UNKNOWN).sum()) * volume.config.voxel_size**3


@kernel
def _mark_seen(
    seen: np.ndarray,  # [S] bool, changed in place
    points: np.ndarray,  # [S, 3] world
    camera_from_world: np.ndarray,  # [4, 4]
    lens: Lens,
    depth: np.ndarray,  # [H, W] metres
    tolerance_m: float,
    tolerance_share: float,
) -> None:
    """Mark the samples that a keyframe sees. Compiled, because every keyframe tests all samples."""
    height, width = depth.shape
    m, (fx, fy, cx, cy) = camera_from_world, lens
    for n in range(len(points)):
        if seen[n]:
            continue
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        far = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        if far <= 0.0:
            continue
        u = np.floor(fx * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / far + cx)
        v = np.floor(fy * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / far + cy)
        if not (0.0 <= u < width and 0.0 <= v < height):
            continue
        observed = depth[int(v), int(u)]
        if observed > 0.0 and abs(observed - far) < tolerance_m + tolerance_share * far:
            seen[n] = True


def reward_terms(
    config: RewardConfig,
    *,
    metres: float,
    invalid: bool,
    share_gained: float | None = None,
    volume_gained: float = 0.0,
) -> dict[str, float]:
    """Return the terms of the reward by name; the reward is their sum.

    ``metres`` is the distance travelled. ``share_gained`` is the newly observed share of the surface in 0..1, None
    without ground truth; ``volume_gained`` in cubic metres then takes its place.
    """
    gained = (
        {"reward/known_volume": config.known_volume * volume_gained}
        if share_gained is None
        else {"reward/coverage": config.coverage * share_gained}
    )
    return gained | {"reward/path": -config.path * metres, "reward/invalid": -config.invalid if invalid else 0.0}
