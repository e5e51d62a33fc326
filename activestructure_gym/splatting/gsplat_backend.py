"""Render with gsplat on a CUDA device (installation extra ``gpu``)."""

from __future__ import annotations

import functools
import importlib.metadata
import importlib.util

import torch

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.splatting.reference import BLUR_VARIANCE, camera_centre, depth_slopes, project_means
from activestructure_gym.splatting.spherical_harmonics import evaluate_sh

VERSION = "1.5"  # of gsplat; later versions have other cut-offs
MAX_ALPHA = 0.999  # upper limit of alpha, compiled into gsplat
DEVICE = "cuda"  # type of torch device on which gsplat runs


@functools.cache
def gsplat_status() -> str:
    """Return ``"works"``, or one sentence on what is missing, found by rendering one Gaussian.

    Importing gsplat succeeds even without a compiler or CUDA device, so the import alone is no test.
    """
    if importlib.util.find_spec("gsplat") is None:
        return "package gsplat is missing: pip install 'activestructure-gym[gpu]'"
    if not (installed := importlib.metadata.version("gsplat")).startswith(f"{VERSION}."):
        return f"gsplat {installed} is installed, expected {VERSION}: pip install 'activestructure-gym[gpu]'"
    if DEVICE == "cuda" and not torch.cuda.is_available():
        return "no CUDA device is visible to torch"
    try:
        device = torch.device(DEVICE)
        color, _, _, _ = rasterize_gsplat(
            torch.tensor([[0.0, 0.0, 1.0]], device=device),
            torch.tensor([[1.0, 0.0, 0.0, 0.0]], device=device),
            torch.full((1, 3), -2.0, device=device),
            torch.full((1,), 3.0, device=device),
            torch.ones((1, 3), device=device),
            torch.eye(4, device=device)[None],
            PinholeCamera.from_size(16, 16),
        )
    except Exception as error:  # a missing compiler, driver or wheel causes errors of many types
        return f"gsplat cannot render: {type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}"
    return "works" if bool(color[0, 8, 8, 0] > 0.5) else "gsplat renders a black picture"


def rasterize_gsplat(
    means: torch.Tensor,  # [N, 3]
    quaternions: torch.Tensor,  # [N, 4] wxyz
    log_scales: torch.Tensor,  # [N, 3]
    opacity_logits: torch.Tensor,  # [N]
    colors: torch.Tensor | None,  # [N, 3]
    camera_from_world: torch.Tensor,  # [C, 4, 4]
    camera: PinholeCamera,
    *,
    sh: torch.Tensor | None = None,  # [N, K, 3] instead of colours
    channels: torch.Tensor | None = None,  # [N, D]
    centre_depth: bool = False,
    blur_variance: float = BLUR_VARIANCE,  # px^2
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor | None]:
    """Return colour ``[C, H, W, 3]``, accumulated depth and alpha ``[C, H, W]``, and channels ``[C, H, W, D]`` or None.

    gsplat itself blends any number of channels per Gaussian, and depths of centres. Depths at ray intersections are
    blended as three channels per camera: the linear functions of the pixel from `depth_planes`.
    """
    from gsplat import rasterization

    cameras = len(camera_from_world)
    if sh is None:
        assert colors is not None
        own = colors.expand(cameras, -1, -1)
    else:
        own = torch.stack([evaluate_sh(sh, means - camera_centre(pose)) for pose in camera_from_world])
    parts = [own] if channels is None else [own, channels.expand(cameras, -1, -1)]
    if not centre_depth:
        parts.append(depth_planes(means, quaternions, log_scales, camera_from_world, camera))
    features = torch.cat(parts, dim=-1)  # [C, N, F], all channels
    intrinsics = torch.tensor(camera.matrix, dtype=torch.float32, device=means.device)
    output, alpha, _ = rasterization(
        means, quaternions, torch.exp(log_scales), torch.sigmoid(opacity_logits), features, camera_from_world,
        intrinsics.expand(cameras, 3, 3).contiguous(), camera.width, camera.height,
        near_plane=0.01, eps2d=blur_variance, packed=False, render_mode="RGB+D" if centre_depth else "RGB",
    )  # fmt: skip
    extra = None if channels is None else output[..., 3 : 3 + channels.shape[1]]
    depth = output[..., -1] if centre_depth else depth_of_planes(output[..., -3:])
    return output[..., :3], depth, alpha[..., 0], extra


def depth_planes(
    means: torch.Tensor,  # [N, 3]
    quaternions: torch.Tensor,  # [N, 4]
    log_scales: torch.Tensor,  # [N, 3]
    camera_from_world: torch.Tensor,  # [C, 4, 4]
    camera: PinholeCamera,
) -> torch.Tensor:  # [C, N, 3]
    """Return coefficients a, b, c of the depth a + b x + c y at which a pixel's ray meets each Gaussian.

    The pixel coordinates x and y are relative to the image centre.
    """
    position, depth = project_means(means, camera_from_world, camera)
    slope = depth_slopes(means, quaternions, log_scales, camera_from_world, camera)
    from_middle = position - position.new_tensor([0.5 * camera.width, 0.5 * camera.height])
    return torch.cat([(depth - (slope * from_middle).sum(dim=-1))[..., None], slope], dim=-1)


def depth_of_planes(blended: torch.Tensor) -> torch.Tensor:  # [C, H, W, 3] -> [C, H, W] metres
    """Return the accumulated depth from an image of blended coefficients of `depth_planes`."""
    height, width = blended.shape[-3:-1]
    x = torch.arange(width, dtype=blended.dtype, device=blended.device) + (0.5 - 0.5 * width)
    y = torch.arange(height, dtype=blended.dtype, device=blended.device) + (0.5 - 0.5 * height)
    return blended[..., 0] + blended[..., 1] * x + blended[..., 2] * y[:, None]
