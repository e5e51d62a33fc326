"""Rendering, scoring and one optimisation step of a Gaussian map on the CPU, without torch.

Parameters are one float32 array ``[14, capacity]``: rows 0-2 mean, 3-6 quaternion wxyz, 7-9 log-scale, 10 opacity
logit, 11-13 colour (0..1, used as it is); the first ``count`` columns live.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.geometry import PinholeCamera, invert_rigid
from activestructure_gym.splatting import kernels
from activestructure_gym.splatting.ssim import ssim_and_gradient

PARAMETER_ROWS = 14
MAX_ALPHA = 0.999


@dataclass(frozen=True)
class Rendering:
    """What a camera sees of the map."""

    color: np.ndarray  # [H, W, 3] float32
    depth: np.ndarray  # [H, W] float32, accumulated: sum of weight times depth; divide by alpha for metres
    alpha: np.ndarray  # [H, W] float32 0..1


@dataclass(frozen=True)
class LossWeights:
    """Weights of the mapping loss: image * (l1_share * L1 + (1 - l1_share) * (1 - SSIM)) + depth * |ED - D|."""

    image: float = 0.5  # of the colour terms
    l1_share: float = 0.8  # of L1 in the colour terms, the rest is SSIM
    depth: float = 1.0  # per metre

    def __post_init__(self) -> None:
        if self.image < 0 or self.depth < 0:
            raise ValueError(f"loss weights must not be negative, got image={self.image}, depth={self.depth}")
        if not 0.0 <= self.l1_share <= 1.0:
            raise ValueError(f"l1_share must lie in [0, 1], got {self.l1_share}")


@dataclass(frozen=True)
class StepLosses:
    """The unweighted terms of the loss before the step."""

    color: float  # mean |colour difference| over pixels and channels
    depth: float  # metres, mean |ED - D| over the pixels that have a depth and alpha > 0.5
    ssim: float  # mean SSIM (1 = equal); nan where the weights leave it out


class Pass:
    """One forward rendering and what its backward pass needs."""

    def __init__(self, parameters, count, camera: PinholeCamera, camera_from_world, max_alpha=MAX_ALPHA) -> None:
        self.parameters, self.count, self.camera = parameters, count, camera
        self.pose = np.ascontiguousarray(camera_from_world, dtype=np.float32)
        self.lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
        self.log2_max_alpha = np.float32(np.log2(max_alpha))
        self.records = np.empty((count, 9), np.float32)
        kernels.project(parameters, count, self.pose, self.lens, camera.width, camera.height, self.records)
        visible = np.flatnonzero(self.records[:, kernels.RADIUS_Y] >= 0)
        self.order = visible[np.argsort(self.records[visible, kernels.DEPTH], kind="stable")]
        shape = (camera.height, camera.width)
        self.color, self.depth = np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32)
        transmittance = np.ones(shape, np.float32)
        colors = parameters[11:]
        kernels.blend(
            self.records, self.order, colors, self.log2_max_alpha, self.color, self.depth, transmittance
        )
        self.alpha = 1.0 - np.abs(transmittance)

    def backward(self, by_color, by_depth, by_alpha):
        """Gradient ``[14, count]``, by pose ``[3, 4]`` and moments ``[count, 11]``."""
        rest = (self.color * by_color).sum(axis=-1) + self.depth * by_depth + self.alpha * by_alpha
        moments = np.zeros((self.count, 11), np.float32)
        kernels.blend_backward(
            self.records, self.order, self.parameters[11:], self.log2_max_alpha, by_color, by_depth, by_alpha,
            rest, np.ones_like(rest), moments,
        )  # fmt: skip
        gradient, by_pose = np.zeros((PARAMETER_ROWS, self.count), np.float32), np.zeros((3, 4), np.float32)
        kernels.project_backward(
            self.parameters, self.order, self.records, moments, self.pose, self.lens, self.camera.width,
            self.camera.height, gradient, by_pose,
        )  # fmt: skip
        return gradient, by_pose, moments


def render(
    parameters: np.ndarray,  # [14, capacity] float32
    count: int,
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [4, 4]
    *,
    max_alpha: float = MAX_ALPHA,
    threads: int | None = None,
) -> Rendering:
    """Colour, accumulated depth and alpha of one camera."""
    _check(parameters, count)
    done = Pass(parameters, count, camera, invert_rigid(world_from_camera), max_alpha)
    return Rendering(done.color, done.depth, done.alpha)


def render_depth_alpha(
    parameters: np.ndarray,  # [14, capacity] float32
    count: int,
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [C, 4, 4]
    *,
    threads: int | None = None,
) -> tuple[np.ndarray, np.ndarray]:  # accumulated depth [C, H, W], alpha [C, H, W]
    """Depth and alpha of many cameras, for scoring candidates."""
    renderings = [render(parameters, count, camera, pose) for pose in np.asarray(world_from_camera)]
    shape = (0, camera.height, camera.width)
    if not renderings:
        return np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    return np.stack([r.depth for r in renderings]), np.stack([r.alpha for r in renderings])


def mapping_step(
    parameters: np.ndarray,  # [14, capacity] float32, changed in place
    first_moment: np.ndarray,  # [14, capacity] float32, changed in place
    second_moment: np.ndarray,  # [14, capacity] float32, changed in place
    count: int,
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [4, 4]
    target_rgb: np.ndarray,  # [H, W, 3] float32 0..1
    target_depth: np.ndarray,  # [H, W] float32 metres, 0 = no return
    weights: LossWeights,
    learning_rates: np.ndarray,  # [14] float32
    *,
    beta1: float = 0.9,
    beta2: float = 0.999,
    epsilon: float = 1e-15,
    threads: int | None = None,
) -> StepLosses:
    """Render, compare, differentiate, and move the Gaussians that have a weight in some pixel (Adam)."""
    _check(parameters, count)
    f32 = np.float32
    done = Pass(parameters, count, camera, invert_rigid(world_from_camera))
    pixels = camera.width * camera.height
    difference = done.color - target_rgb
    by_color = np.sign(difference) * f32(weights.image * weights.l1_share / (3 * pixels))
    ssim = float("nan")
    if weights.image > 0 and weights.l1_share < 1:
        ssim, by_ssim = ssim_and_gradient(done.color, target_rgb)
        by_color -= f32(weights.image * (1 - weights.l1_share)) * by_ssim
    mask = (target_depth > 0) & (done.alpha > 0.5)
    expected = done.depth / np.where(mask, done.alpha, f32(1))
    error = np.where(mask, expected - target_depth, f32(0))
    measured = max(1, int(mask.sum()))
    by_expected = np.sign(error) * f32(weights.depth / measured)
    by_depth = np.where(mask, by_expected / np.where(mask, done.alpha, f32(1)), f32(0))
    by_alpha = -by_depth * expected
    losses = StepLosses(float(np.abs(difference).mean()), float(np.abs(error).sum() / measured), ssim)
    gradient, _, moments = done.backward(by_color, by_depth, by_alpha)
    kernels.adam(
        parameters, first_moment, second_moment, done.order, moments, gradient,
        np.asarray(learning_rates, f32), f32(beta1), f32(beta2), f32(epsilon),
    )  # fmt: skip
    return losses


def _check(parameters: np.ndarray, count: int) -> None:
    if parameters.ndim != 2 or parameters.shape[0] != PARAMETER_ROWS or parameters.dtype != np.float32:
        raise ValueError(f"parameters must be float32 [14, capacity], got {parameters.dtype} {parameters.shape}")
    if not 0 <= count <= parameters.shape[1]:
        raise ValueError(f"count must lie in 0..{parameters.shape[1]}, got {count}")
