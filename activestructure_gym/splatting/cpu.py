"""Render, score and optimise a Gaussian map on the CPU, without torch.

Parameters are one float32 array ``[14, capacity]``: rows 0-2 mean (metres, world), 3-6 quaternion wxyz, 7-9 natural
logarithm of the standard deviations in metres, 10 opacity logit, 11-13 colour (0..1, used unchanged). The first
``count`` columns are in use.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from activestructure_gym.compiling.thread_team import TEAM, default_threads
from activestructure_gym.geometry import PinholeCamera, invert_rigid
from activestructure_gym.geometry.frame import Frame, unit_rgb
from activestructure_gym.ranges import check_ranges
from activestructure_gym.splatting import layout, scoring
from activestructure_gym.splatting.workspace import (
    MAX_ALPHA,
    PooledWorkspace,
    aligned_zeros,
    fitted,
    inverse_of_pose,
    make_grid,
    make_view,
)

PARAMETER_ROWS = layout.ROWS
_NO_VALUES = np.empty(0, np.float32)


@dataclass(frozen=True)
class Rendering:
    """Hold colour, accumulated depth and alpha of one camera."""

    color: np.ndarray  # [H, W, 3] float32
    # [H, W] float32 accumulated depth: sum of weight times depth, metres; depth is this divided by alpha.
    depth: np.ndarray
    alpha: np.ndarray  # [H, W] float32 0..1


@dataclass(frozen=True)
class LossWeights:
    """Define the weights of the mapping loss.

    Loss = image * (l1_share * L1 + (1 - l1_share) * (1 - SSIM)) + depth * |ED - D| + alpha * M, with measured depth D.

    - L1 is the mean absolute colour difference over pixels and channels.
    - ED is the accumulated depth divided by alpha A, and compared where A is above 0.5. With ``normalised_depth=False``
      it
      is the accumulated depth itself, compared at every pixel with a measured depth. The sum is divided by the number
      of pixels with a measured depth.
    - M is the mean over all pixels of (1 - A)^2 at pixels with a measured depth, else 0. Without this term black
      surfaces
      become transparent, since the background is black.
    """

    image: float = 0.5  # weight of the colour terms
    l1_share: float = 0.8  # weight of L1 in the colour terms; the rest is the weight of SSIM
    depth: float = 1.0  # weight of the depth term, per metre
    alpha: float = 0.0  # weight of missing opacity at pixels with a measured depth
    normalised_depth: bool = True  # whether the depth term compares accumulated depth / alpha
    centre_depth: bool = False  # whether depth is that of centres instead of ray intersections

    def __post_init__(self) -> None:
        check_ranges(self, {**dict.fromkeys(("image", "depth", "alpha"), "[0, 1e6]"), "l1_share": "[0, 1]"})


@dataclass(frozen=True)
class StepLosses:
    """Hold the unweighted terms of the mapping loss before a step."""

    color: float  # mean absolute colour difference over pixels and channels
    # Metres: sum of |ED - D| / number of pixels with a measured depth, see `LossWeights`.
    depth: float
    ssim: float  # mean SSIM (1 = equal); nan if its weight is 0


def render(
    parameters: np.ndarray,  # [14, capacity] float32
    count: int,  # number of Gaussians
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [4, 4]
    *,
    max_alpha: float = MAX_ALPHA,
    centre_depth: bool = False,
    blur_variance: float = float(layout.BLUR_VARIANCE),  # px^2
    threads: int | None = None,
    unseen: np.ndarray | None = None,  # [chunks of 1024 Gaussians] bool, see below
) -> Rendering:
    """Render colour, accumulated depth and alpha of one camera.

    A pixel uses the depth at which its ray meets a Gaussian, or with ``centre_depth`` the depth of the centre.
    ``blur_variance`` is added to the covariance in the image; [gsplat, code] uses 0.3. ``unseen`` marks chunks of
    Gaussians that are known to be outside the view, which saves time for a large map.
    """
    check_map(parameters, count)
    pooled = PooledWorkspace()
    pooled.workspace.render(
        fitted(parameters), count, camera, inverse_of_pose(world_from_camera), max_alpha=max_alpha,
        centre_depth=centre_depth, blur_variance=blur_variance, threads=threads, keep=False, unseen=unseen,
    )  # fmt: skip
    return Rendering(*pooled.workspace.pictures())


def render_depth_alpha(
    parameters: np.ndarray,  # [14, capacity] float32
    count: int,  # number of Gaussians
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [C, 4, 4]
    *,
    centre_depth: bool = False,
    blur_variance: float = float(layout.BLUR_VARIANCE),  # px^2
    threads: int | None = None,
) -> tuple[np.ndarray, np.ndarray]:  # accumulated depth [C, H, W] metres, alpha [C, H, W]
    """Render accumulated depth and alpha of C cameras, for scoring candidates; arguments as in `render`."""
    view = make_view(camera, np.eye(4), centre_depth=centre_depth, blur_variance=blur_variance)
    return _score(parameters, count, camera, world_from_camera, view, _NO_VALUES, threads)


def render_values(
    parameters: np.ndarray,  # [14, capacity] float32
    count: int,  # number of Gaussians
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [C, 4, 4]
    values: np.ndarray,  # [N] one per Gaussian
    *,
    threads: int | None = None,
) -> np.ndarray:  # [C, H, W] float32
    """Render one number per Gaussian from C cameras, blended as a channel of `render`'s colour is."""
    view = make_view(camera, np.eye(4))
    view[layout.MIN_DEPTH] = -np.inf  # values have no lower bound
    values = np.ascontiguousarray(values, np.float32)
    if values.shape != (count,):
        raise ValueError(f"values must have one number per Gaussian, ({count},), got {values.shape}")
    return _score(parameters, count, camera, world_from_camera, view, values, threads)[0]


def _score(
    parameters: np.ndarray,
    count: int,
    camera: PinholeCamera,
    world_from_camera: np.ndarray,
    view: np.ndarray,  # [VIEW_SIZE], with any pose
    values: np.ndarray,  # [N] float32, or empty for depth
    threads: int | None,
) -> tuple[np.ndarray, np.ndarray]:  # depth or values [C, H, W], alpha [C, H, W]
    check_map(parameters, count)
    poses = invert_rigid(np.asarray(world_from_camera, dtype=np.float64).reshape(-1, 4, 4))
    parameters = fitted(parameters)
    views = np.repeat(view[None], len(poses), axis=0)
    views[:, : layout.FX] = poses[:, :3].reshape(-1, layout.FX)
    images = np.empty((2, len(poses), camera.height, camera.width), np.float32)
    threads = min(threads or default_threads(), max(1, len(poses)))
    grid, shapes = make_grid(count, parameters.shape[1], camera), aligned_zeros(layout.RECORD * parameters.shape[1])
    reaches = aligned_zeros(parameters.shape[1])
    TEAM.run(scoring.shape, (np.zeros(1, np.int64), parameters, grid, shapes, reaches), threads)
    sources = (parameters, shapes, reaches, views, grid, values)
    TEAM.run(scoring.score, (np.zeros(1, np.int64), *sources, images.reshape(2, -1)), threads)
    return images[0], images[1]


def mapping_step(
    parameters: np.ndarray,  # [14, capacity] float32, changed in place
    first_moment: np.ndarray,  # [14, capacity] float32, changed in place
    second_moment: np.ndarray,  # [14, capacity] float32, changed in place
    count: int,  # number of Gaussians
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [4, 4]
    target_rgb: np.ndarray,  # [H, W, 3] float32 0..1
    target_depth: np.ndarray,  # [H, W] float32 metres, 0 = no return
    *,
    weights: LossWeights,
    learning_rates: np.ndarray,  # [14] float32, one per row of the parameters
    beta1: float = 0.9,
    beta2: float = 0.999,
    epsilon: float = 1e-15,
    isotropic: bool = False,
    threads: int | None = None,
    unseen: np.ndarray | None = None,  # [chunks] bool, as in `render`
) -> StepLosses:
    """Take one optimiser step on the loss of one image; only Gaussians that contribute to some pixel change.

    The step is Adam without bias correction. With ``isotropic`` the three log-scales of a Gaussian are one parameter:
    each row gets the sum of their gradients, so equal scales remain equal. Raises `ValueError` for arrays of another
    shape or type, or for isotropic Gaussians with different learning rates of the log-scales.
    """
    check_map(parameters, count)
    check_state(parameters, first_moment, second_moment)
    log_scale_rates = np.broadcast_to(learning_rates, PARAMETER_ROWS)[7:10]
    if isotropic and np.ptp(log_scale_rates):
        raise ValueError(f"isotropic Gaussians need one learning rate for their log-scales, got {log_scale_rates}")
    rates = np.empty(layout.RATES, np.float32)
    rates[: layout.ROWS] = learning_rates
    rates[layout.ROWS :] = beta1, beta2, epsilon, layout.TO_ADAM, isotropic
    state = (parameters, first_moment, second_moment)
    used = tuple(fitted(array) for array in state)
    pooled = PooledWorkspace()
    workspace = pooled.workspace
    pose, of_color = inverse_of_pose(world_from_camera), weights.image * weights.l1_share
    if weights.image * (1.0 - weights.l1_share) == 0.0:
        workspace.prepare(
            used[0], count, camera, pose, centre_depth=weights.centre_depth, threads=threads, unseen=unseen
        )
        color, depth = workspace.fused_step(
            target_rgb, target_depth, rates, *used[1:], of_color=of_color, of_depth=weights.depth,
            of_alpha=weights.alpha, normalised_depth=weights.normalised_depth,
        )  # fmt: skip
        ssim = float("nan")
    else:
        workspace.render(
            used[0], count, camera, pose, centre_depth=weights.centre_depth, threads=threads, unseen=unseen
        )
        color, depth, ssim = workspace.losses(
            target_rgb, target_depth, of_color, weights.image * (1.0 - weights.l1_share), weights.depth, weights.alpha,
            weights.normalised_depth,
        )  # fmt: skip
        workspace.backward(rates, used[1], used[2], used[0])
    for array, copy in zip(state, used):
        if copy is not array:
            array[:] = copy[:, : array.shape[1]]
    return StepLosses(color, depth, ssim)


class Steps:
    """Take the optimiser steps of a mapping event by `mapping_step`; implements `rasterizers.Steps`."""

    def __init__(
        self,
        parameters: np.ndarray,  # [14, capacity] float32
        first_moment: np.ndarray,  # [14, capacity] float32
        second_moment: np.ndarray,  # [14, capacity] float32
        count: int,
        **options: Any,  # weights, beta1, beta2 and isotropic of `mapping_step`
    ) -> None:
        self._step: Any = partial(mapping_step, parameters, first_moment, second_moment, count, **options)
        self._losses: list[tuple[float, float, float]] = []

    def step(self, frame: Frame, **options: Any) -> None:
        """Take one step on the loss of a frame; ``options`` are the others of `mapping_step`."""
        losses = self._step(frame.camera, frame.world_from_camera, unit_rgb(frame), frame.depth, **options)
        self._losses.append((losses.color, losses.depth, losses.ssim))

    def end(self) -> np.ndarray:  # [steps, 3] float64
        """Return colour loss, depth loss in metres and SSIM of each step. The arrays are already changed."""
        return np.array(self._losses, np.float64).reshape(-1, 3)


begin = Steps


def check_map(parameters: np.ndarray, count: int) -> None:
    """Raise `ValueError` unless ``parameters`` is float32 [14, capacity] with at least ``count`` columns."""
    if parameters.ndim != 2 or parameters.shape[0] != PARAMETER_ROWS or parameters.dtype != np.float32:
        raise ValueError(f"parameters must be float32 [14, capacity], got {parameters.dtype} {parameters.shape}")
    if not 0 <= count <= parameters.shape[1]:
        raise ValueError(f"count must lie in 0..{parameters.shape[1]}, got {count}")


def check_state(parameters: np.ndarray, first_moment: np.ndarray, second_moment: np.ndarray) -> None:
    """Raise `ValueError` unless the Adam moments have shape and type of the parameters."""
    for name, array in (("first_moment", first_moment), ("second_moment", second_moment)):
        if array.shape != parameters.shape or array.dtype != np.float32:
            raise ValueError(f"{name} must be float32 {parameters.shape}, got {array.dtype} {array.shape}")
