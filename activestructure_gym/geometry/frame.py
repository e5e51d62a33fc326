"""Hold one RGB-D observation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.geometry import PinholeCamera, transform_points


@dataclass(frozen=True)
class Frame:
    """Hold colour, depth and the sensor's reported pose, which may be noisy."""

    rgb: np.ndarray  # [H, W, 3] uint8
    depth: np.ndarray  # [H, W] float32 metres along the optical axis, 0 = no return
    world_from_camera: np.ndarray  # [4, 4] float64
    camera: PinholeCamera  # of both rgb and depth

    def world_points(self) -> np.ndarray:  # [M, 3] float64
        """Return the world points of all pixels with a return, row by row, in metres."""
        return transform_points(self.world_from_camera, self.camera.backproject(self.depth)[self.depth > 0])
