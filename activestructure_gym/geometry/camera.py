"""Define the pinhole camera: rays through pixels, back-projection of depth, projection of points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


class Lens(NamedTuple):
    """Hold focal lengths and principal point in pixels as a named tuple, the form that compiled kernels accept."""

    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True)
class PinholeCamera:
    """Hold the intrinsics of a pinhole camera without distortion.

    Pixel (column u, row v) covers [u, u + 1) x [v, v + 1); its centre is (u + 0.5, v + 0.5).

    Parameters
    ----------
    width, height
        Image size in pixels.
    fx, fy
        Focal lengths in pixels.
    cx, cy
        Principal point in pixels.

    Examples
    --------
    >>> camera = PinholeCamera.from_size(320, 180)
    >>> round(camera.fx, 6), camera.project(np.array([0.0, 0.0, 2.0])).tolist()
    (160.0, [160.0, 90.0])
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise ValueError(f"an image needs at least one pixel, got {self.width} x {self.height}")
        if not (self.fx > 0 and self.fy > 0):
            raise ValueError(f"focal lengths must be above 0, got fx={self.fx}, fy={self.fy}")

    @classmethod
    def from_size(cls, width: int, height: int, horizontal_fov_deg: float = 90.0) -> PinholeCamera:
        """Return a camera with square pixels and a central principal point.

        ``width`` and ``height`` are in pixels. The default field of view of 90 degrees gives a focal length of
        ``width / 2`` pixels (the paper's 60 x 90 degrees).
        """
        if not 0.0 < horizontal_fov_deg < 180.0:
            raise ValueError(f"horizontal_fov_deg must lie in (0, 180), got {horizontal_fov_deg}")
        focal = 0.5 * width / np.tan(np.radians(horizontal_fov_deg) / 2.0)
        return cls(width, height, float(focal), float(focal), width / 2.0, height / 2.0)

    def resized(self, width: int, height: int) -> PinholeCamera:
        """Return a camera of the same field of view with ``width`` x ``height`` pixels."""
        sx, sy = width / self.width, height / self.height
        return PinholeCamera(width, height, self.fx * sx, self.fy * sy, self.cx * sx, self.cy * sy)

    @property
    def lens(self) -> Lens:
        """Return fx, fy, cx and cy in pixels, without the image size."""
        return Lens(self.fx, self.fy, self.cx, self.cy)

    @property
    def matrix(self) -> np.ndarray:  # [3, 3]
        """Return the 3x3 intrinsic matrix K in pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def rays(self, supersample: int = 1) -> np.ndarray:  # [H * s, W * s, 3] float32
        """Return one ray direction in the camera frame through the centre of each pixel.

        With ``supersample`` = s, each pixel is divided into s x s subpixels and has one ray per subpixel. Each
        direction has z = 1, so that direction times depth is the point at that depth.
        """
        u = (np.arange(self.width * supersample) + 0.5) / supersample
        v = (np.arange(self.height * supersample) + 0.5) / supersample
        rays = np.empty((len(v), len(u), 3), dtype=np.float32)
        rays[..., 0] = (u[None, :] - self.cx) / self.fx
        rays[..., 1] = (v[:, None] - self.cy) / self.fy
        rays[..., 2] = 1.0
        return rays

    def backproject(self, depth: np.ndarray) -> np.ndarray:  # depth [H, W] -> [H, W, 3] camera frame
        """Return the camera-frame point of each pixel in metres; pixels with depth 0 give the origin."""
        return self.rays() * depth[..., None]

    def in_image(self, points: np.ndarray) -> np.ndarray:  # [N, 3] camera frame -> [N] bool
        """Return which points are ahead of the camera and inside its image."""
        x, y, z = points.T
        ahead = z > 0.0
        depth = np.where(ahead, z, 1.0)
        u, v = self.fx * x / depth + self.cx, self.fy * y / depth + self.cy
        return np.asarray(ahead & (u >= 0) & (u < self.width) & (v >= 0) & (v < self.height))

    def project(self, points: np.ndarray) -> np.ndarray:  # [..., 3] camera frame -> [..., 2] pixels
        """Project camera-frame points in metres to pixel coordinates (u, v); all points must have z > 0."""
        z = points[..., 2]
        return np.stack([self.fx * points[..., 0] / z + self.cx, self.fy * points[..., 1] / z + self.cy], axis=-1)
