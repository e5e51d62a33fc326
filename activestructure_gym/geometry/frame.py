"""Define one posed RGB-D observation."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from activestructure_gym.errors import InputWarning
from activestructure_gym.geometry import PinholeCamera, transform_points

_MILLIMETRES = 100.0, 65_536.0  # range of depths of 16 bits in millimetres; no sensor measures only these in metres


@dataclass(frozen=True)
class Frame:
    """Hold a colour image, its depth image and the pose that the sensor reports, which may contain noise."""

    rgb: np.ndarray  # [H, W, 3] uint8
    depth: np.ndarray  # [H, W] float32 metres along the optical axis, 0 = no return or no measurement
    world_from_camera: np.ndarray  # [4, 4] float64 reported pose
    camera: PinholeCamera  # intrinsics of both images
    # [H, W] bool: pixels that were not measured; their depth of 0 proves nothing. None: depth 0 means that there is no
    # surface within the sensor's range. Frames of a `World` have infinite depth there, and 0 is not measured.
    unmeasured: np.ndarray | None = None

    def world_points(self) -> np.ndarray:  # [M, 3] float64
        """Return the world points in metres of all pixels with depth above 0, in row-major order of the pixels."""
        return transform_points(self.world_from_camera, self.camera.backproject(self.depth)[self.depth > 0])


def unit_rgb(frame: Frame) -> np.ndarray:  # [H, W, 3] float32 0..1
    """Return the colours of a frame as numbers in 0..1."""
    return frame.rgb * np.float32(1.0 / 255.0)


def warn_of_millimetres(depth: np.ndarray, *, stacklevel: int) -> None:  # [H, W] floats, metres
    """Issue an `InputWarning` if the nearest depth above 0 is 100 to 65,536: these are millimetres of 16 bits."""
    low, high = _MILLIMETRES
    with np.errstate(invalid="ignore"):
        nearest = float(np.min(depth, where=depth > 0.0, initial=np.inf))
    if low <= nearest < high:
        text = f"all depths of a frame are above {low:g} m: if they are in millimetres, divide them by 1000.0"
        warnings.warn(text, InputWarning, stacklevel=stacklevel + 1)
