"""The reward: newly seen ground-truth surface, minus the way there. Ground truth stays in this module."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.geometry import PinholeCamera, invert_rigid, transform_points


@dataclass(frozen=True)
class RewardConfig:
    """Weights of the reward's terms."""

    coverage: float = 20.0  # per unit of observed surface share (GenNBV and GLEAM use 20 x delta C.R.)
    path: float = 0.01  # per metre travelled
    invalid: float = 0.05  # for choosing a masked action
    tolerance_m: float = 0.05  # a sample is seen if the sensor's depth agrees this well; the C.R. threshold
    tolerance_share: float = 0.01  # of the depth, on top: a pixel is wider far away


class SurfaceCoverage:
    """Which samples of the observable surface some keyframe has seen."""

    def __init__(self, points: np.ndarray, config: RewardConfig) -> None:
        self._points = np.asarray(points, dtype=np.float64)  # [S, 3] world
        self._config = config
        self.seen = np.zeros(len(points), dtype=bool)

    @property
    def share(self) -> float:
        """Seen samples / all samples, 0..1."""
        return float(self.seen.mean()) if len(self.seen) else 1.0

    def add(self, depth: np.ndarray, camera: PinholeCamera, world_from_camera: np.ndarray) -> None:
        """Count what a depth image [H, W] taken at the true pose [4, 4] shows."""
        todo = np.flatnonzero(~self.seen)
        local = transform_points(invert_rigid(world_from_camera), self._points[todo])
        todo, local = todo[local[:, 2] > 0], local[local[:, 2] > 0]
        pixel = np.floor(camera.project(local)).astype(int)
        inside = ((pixel >= 0) & (pixel < [camera.width, camera.height])).all(axis=1)
        todo, local, pixel = todo[inside], local[inside], pixel[inside]
        tolerance = self._config.tolerance_m + self._config.tolerance_share * local[:, 2]
        observed = depth[pixel[:, 1], pixel[:, 0]]
        self.seen[todo[(observed > 0) & (np.abs(observed - local[:, 2]) < tolerance)]] = True


def reward_terms(
    config: RewardConfig, *, share_gained: float, metres: float, invalid: bool
) -> dict[str, float]:
    """The terms by name; their sum is the reward."""
    return {
        "reward/coverage": config.coverage * share_gained,
        "reward/path": -config.path * metres,
        "reward/invalid": -config.invalid if invalid else 0.0,
    }
