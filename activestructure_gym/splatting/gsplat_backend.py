"""Render with gsplat on a CUDA device (installation extra ``gpu``)."""

from __future__ import annotations

import functools
import importlib.metadata
import importlib.util
from collections.abc import Sequence

import torch

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.splatting import reference
from activestructure_gym.splatting.spherical_harmonics import evaluate_sh

VERSION = "1.5"  # of gsplat; later versions have other cut-offs
MAX_ALPHA = 0.999  # upper limit of alpha, compiled into gsplat
DEVICE = "cuda"  # type of torch device on which gsplat runs
_TILE = 16  # pixels, gsplat's own default


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
    blur_variance: float = reference.BLUR_VARIANCE,  # px^2
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
        own = torch.stack([evaluate_sh(sh, means - reference.camera_centre(pose)) for pose in camera_from_world])
    parts = [own] if channels is None else [own, channels.expand(cameras, -1, -1)]
    if not centre_depth:
        parts.append(depth_planes(means, reference.world_axes(quaternions, log_scales), camera_from_world, camera))
    features = torch.cat(parts, dim=-1)  # [C, N, F], all channels
    mode = "RGB+D" if centre_depth else "RGB"
    output, alpha, _ = rasterization(
        means, quaternions, torch.exp(log_scales), torch.sigmoid(opacity_logits), features, camera_from_world,
        _intrinsics(camera, means.device).expand(cameras, 3, 3).contiguous(), camera.width, camera.height,
        near_plane=reference.NEAR_PLANE, eps2d=blur_variance, packed=False, render_mode=mode,
    )  # fmt: skip
    more = 0 if channels is None else channels.shape[1]
    color, extra, last = output.split([3, more, 1 if centre_depth else 3], dim=-1)
    depth = last[..., 0] if centre_depth else depth_of_planes(last, camera)
    return color, depth, alpha[..., 0], extra if more else None


def depth_alpha_gsplat(
    parts: Sequence[torch.Tensor],  # [N, D] each: means, quaternions, log-scales, opacity logits
    camera_from_world: torch.Tensor,  # [C, 4, 4]
    camera: PinholeCamera,
) -> torch.Tensor:  # [2, C, H, W]
    """Return accumulated depth in metres and alpha of C cameras, without gradients.

    Only the three channels of the depth are blended, and only for the Gaussians in the view of each camera
    (gsplat's packed form).
    """
    from gsplat import fully_fused_projection, isect_offset_encode, isect_tiles, rasterize_to_pixels

    means, quaternions, log_scales, logits = parts[:4]
    cameras, (width, height), opacities = len(camera_from_world), (camera.width, camera.height), logits[:, 0].sigmoid()
    _, camera_ids, ids, radii, means2d, depths, conics, _ = fully_fused_projection(
        means, None, quaternions, torch.exp(log_scales), camera_from_world,
        _intrinsics(camera, means.device).expand(cameras, 3, 3).contiguous(), width, height,
        eps2d=reference.BLUR_VARIANCE, near_plane=reference.NEAR_PLANE, packed=True, opacities=opacities,
    )  # fmt: skip
    axes = reference.world_axes(quaternions, log_scales)[ids, None]
    planes = depth_planes(means[ids, None], axes, camera_from_world[camera_ids], camera)[:, 0]
    tiles_x, tiles_y = -(-width // _TILE), -(-height // _TILE)
    _, keys, order = isect_tiles(
        means2d, radii, depths, _TILE, tiles_x, tiles_y,
        packed=True, n_images=cameras, image_ids=camera_ids, gaussian_ids=ids,
    )  # fmt: skip
    blended, alpha = rasterize_to_pixels(
        means2d, conics, planes, opacities[ids], width, height, _TILE,
        isect_offset_encode(keys, cameras, tiles_x, tiles_y), order, packed=True,
    )  # fmt: skip
    return torch.stack([depth_of_planes(blended, camera), alpha[..., 0]])


def depth_planes(
    means: torch.Tensor,  # [..., N, 3]
    axes: torch.Tensor,  # [..., N, 3, 3] see `world_axes`
    camera_from_world: torch.Tensor,  # [..., 4, 4]
    camera: PinholeCamera,
) -> torch.Tensor:  # [..., N, 3]
    """Return coefficients a, b, c of the depth a + b x + c y at which a pixel's ray meets each Gaussian.

    The pixel coordinates x and y are relative to the principal point.
    """
    position, depth, in_camera = reference.project(means, axes, camera_from_world, camera)
    slope = reference.depth_slopes(in_camera)
    from_centre = position - reference.lens(camera, position.dtype, position.device)[1]
    return torch.cat([(depth - (slope * from_centre).sum(dim=-1))[..., None], slope], dim=-1)


def depth_of_planes(blended: torch.Tensor, camera: PinholeCamera) -> torch.Tensor:  # [C, H, W, 3] -> [C, H, W] metres
    """Return the accumulated depth from an image of blended coefficients of `depth_planes`."""
    x = torch.arange(camera.width, dtype=blended.dtype, device=blended.device) + (0.5 - camera.cx)
    y = torch.arange(camera.height, dtype=blended.dtype, device=blended.device) + (0.5 - camera.cy)
    constant, by_x, by_y = blended.unbind(-1)
    return constant + by_x * x + by_y * y[:, None]


@functools.lru_cache(64)
def _intrinsics(camera: PinholeCamera, device: torch.device) -> torch.Tensor:  # [3, 3] float32
    return torch.tensor(camera.matrix, dtype=torch.float32, device=device)
