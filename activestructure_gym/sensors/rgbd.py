"""Simulate the agent's RGB-D camera: a renderer, a noise model and its own random generator."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from activestructure_gym.errors import InputError, short_repr, unknown_name
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.ranges import MAX_ASPECT_RATIO, check_ranges
from activestructure_gym.scenes.scene import Scene
from activestructure_gym.sensors.noise import DEPTH_NOISE, DepthNoise, drop_edges, noisy_depth, noisy_pose
from activestructure_gym.sensors.renderer import RENDERERS, Renderer, make_renderer

# Rays per image. More is a typing mistake.
_MAX_RAYS = 1 << 25
_RANGES = {
    "width": "[1, 8192]",
    "height": "[1, 8192]",
    "horizontal_fov_deg": "[0.1, 179]",
    "max_range": "[0.01, 1000]",
    "supersample": "[1, 16]",
    "noise_multiplier": "[0, 1000]",
    "pose_noise_m": "[0, 100]",
    "pose_noise_deg": "[0, 180]",
}


@dataclass(frozen=True)
class SensorConfig:
    """Configure the camera and its errors. Invalid values raise `InputError`."""

    width: int = 160  # pixels
    height: int = 90  # pixels
    horizontal_fov_deg: float = 90.0  # degrees; the paper's 60 x 90 deg
    intrinsics: tuple[float, float, float, float] | None = None  # fx, fy, cx, cy in pixels; overrides the field of view
    max_range: float = 10.0  # metres along the optical axis; farther returns become 0
    supersample: int = 2  # colour samples per pixel and axis; with 1, aliasing alone limits PSNR to about 30 dB
    backend: str = "auto"  # renderer: auto, raycast, warp, pyrender, or package.module:Name
    depth_noise: DepthNoise = "none"  # the paper has none
    noise_multiplier: float = 1.0  # scales every depth error; 0 = none
    edge_dropout: bool = False  # holes near depth edges and on slanted surfaces
    pose_noise_m: float = 0.0  # metres per axis, standard deviation of the reported position
    pose_noise_deg: float = 0.0  # degrees per axis, standard deviation of the reported rotation

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES, "sensor ")
        if max(self.width, self.height) > MAX_ASPECT_RATIO * min(self.width, self.height):
            raise InputError(
                f"the longer side of the sensor's image must be at most {MAX_ASPECT_RATIO} times the shorter one, got "
                f"{self.width} x {self.height} pixels"
            )
        if self.intrinsics is not None:
            lens = _lens_of(self.intrinsics)
            if lens is None:
                raise InputError(
                    "sensor intrinsics are fx, fy, cx, cy in pixels, focal lengths above 0, got "
                    f"{short_repr(self.intrinsics)}"
                )
            object.__setattr__(self, "intrinsics", lens)
        rays = int(self.width) * int(self.height) * int(self.supersample) ** 2
        if rays > _MAX_RAYS:
            raise InputError(
                f"sensor width x height x supersample^2 must be at most {_MAX_RAYS} rays, got {rays}: "
                "choose smaller images or a smaller supersample"
            )
        if not isinstance(self.edge_dropout, (bool, np.bool_)):
            raise InputError(f"sensor edge_dropout must be True or False, got {short_repr(self.edge_dropout)}")
        RENDERERS.get(self.backend)
        if self.depth_noise not in DEPTH_NOISE:
            raise unknown_name("depth noise", str(self.depth_noise), DEPTH_NOISE)

    @property
    def camera(self) -> PinholeCamera:
        """Return the pinhole camera; without ``intrinsics`` it has square pixels and a central principal point."""
        if self.intrinsics is not None:
            return PinholeCamera(self.width, self.height, *self.intrinsics)
        return PinholeCamera.from_size(self.width, self.height, self.horizontal_fov_deg)


def _lens_of(value: Any) -> tuple[float, float, float, float] | None:
    """Return fx, fy, cx, cy in pixels as floats; None for other values than four numbers with focal lengths above 0."""
    numbers = tuple(value) if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str) else ()
    kinds = int, float, np.integer, np.floating
    try:
        given = [float(one) for one in numbers if isinstance(one, kinds) and not isinstance(one, bool)]
    except OverflowError:  # a whole number of hundreds of digits
        return None
    if len(numbers) == len(given) == 4 and all(abs(one) < 1e6 for one in given) and min(given[:2]) > 1e-3:
        return given[0], given[1], given[2], given[3]
    return None


# Largest entries of R R^T - I outside and on the diagonal, and largest error of the last row.
_ROTATION_ERROR, _LENGTH_ERROR, _LAST_ROW_ERROR = 1e-5, 2e-5, 1e-8


def _checked_pose(world_from_camera: np.ndarray) -> np.ndarray:
    pose = np.asarray(world_from_camera, dtype=np.float64)
    if pose.shape != (4, 4):
        raise ValueError(f"world_from_camera must be [4, 4], got {pose.shape}")
    x, y, z, last = pose.tolist()  # plain numbers: numpy takes ten times as long for so few
    products = [a[0] * b[0] + a[1] * b[1] + a[2] * b[2] for a, b in ((x, x), (y, y), (z, z), (x, y), (x, z), (y, z))]
    volume = (
        x[0] * (y[1] * z[2] - y[2] * z[1]) - x[1] * (y[0] * z[2] - y[2] * z[0]) + x[2] * (y[0] * z[1] - y[1] * z[0])
    )
    if not (
        max(abs(length - 1.0) for length in products[:3]) <= _LENGTH_ERROR
        and max(map(abs, products[3:])) <= _ROTATION_ERROR
        and volume > 0
        and all(abs(error) <= _LAST_ROW_ERROR for error in (last[0], last[1], last[2], last[3] - 1.0))
        and math.isfinite(x[3] + y[3] + z[3])
    ):
        raise ValueError(f"world_from_camera must be a rigid motion, got\n{pose}")
    return pose


class RGBDSensor:
    """Capture frames of one scene. Images are taken at the true pose; the frame carries the reported pose.

    ``rng`` drives all noise and must not be shared: the same seed and sequence of poses give the same frames. Pickling
    keeps the state of the noise and rebuilds the renderer.
    """

    def __init__(self, scene: Scene, config: SensorConfig, rng: np.random.Generator) -> None:
        self.config = config
        self.camera = config.camera
        self._rng = rng
        self._renderer: Renderer = make_renderer(config.backend, scene)

    @property
    def backend(self) -> str:
        """Return the name of the renderer in use (``auto`` resolved)."""
        return self._renderer.name

    def capture(self, world_from_camera: np.ndarray) -> Frame:
        """Return the frame at the true pose ``world_from_camera`` [4, 4]; raise ValueError if it is not rigid."""
        pose, config = _checked_pose(world_from_camera), self.config
        rgb, true = self._renderer.render(self.camera, pose, supersample=config.supersample)
        depth = noisy_depth(true, self.camera, self._rng, model=config.depth_noise, multiplier=config.noise_multiplier)
        if config.edge_dropout:
            depth = drop_edges(depth, true, self.camera, self._rng)
        # Noise comes first: the range limits the reported depth.
        depth = self._within_range(depth)
        reported = noisy_pose(pose, self._rng, sigma_m=config.pose_noise_m, sigma_deg=config.pose_noise_deg)
        return Frame(rgb=rgb, depth=depth, world_from_camera=np.array(reported), camera=self.camera)

    @property
    def has_depth_noise(self) -> bool:
        """Return whether the depth of a frame can differ from `true_depth`."""
        config = self.config
        return config.edge_dropout or (config.depth_noise != "none" and config.noise_multiplier > 0)

    def true_depth(self, world_from_camera: np.ndarray) -> np.ndarray:  # [H, W] float32 metres, 0 = no return
        """Return the noise-free depth at a pose. Ground truth; draws no random number."""
        _, depth = self._renderer.render(self.camera, _checked_pose(world_from_camera), supersample=1)
        return self._within_range(depth)

    def _within_range(self, depth: np.ndarray) -> np.ndarray:
        return np.where(depth <= np.float32(self.config.max_range), depth, np.float32(0.0))

    def close(self) -> None:
        """Release threads and graphics contexts; may be called twice."""
        self._renderer.close()
