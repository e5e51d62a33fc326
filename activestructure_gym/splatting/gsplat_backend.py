"""The rasteriser's pictures by gsplat on a CUDA device (extra ``gpu``)."""

from __future__ import annotations

import functools
import importlib.metadata

import torch

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.splatting.reference import camera_centre
from activestructure_gym.splatting.spherical_harmonics import TERMS, evaluate_sh

_ALPHA_LIMITS = ((1, 6), 0.999, 0.99)  # from this version on the second


@functools.cache
def gsplat_max_alpha() -> float:
    """The alpha limit compiled into the gsplat that is installed."""
    version = tuple(int("".join(filter(str.isdigit, part)) or 0) for part in
                    importlib.metadata.version("gsplat").split(".")[:2])  # fmt: skip
    since, before, after = _ALPHA_LIMITS
    return after if version >= since else before


def rasterize_gsplat(
    means: torch.Tensor,  # [N, 3]
    quaternions: torch.Tensor,  # [N, 4] wxyz
    log_scales: torch.Tensor,  # [N, 3]
    opacity_logits: torch.Tensor,  # [N]
    colors: torch.Tensor | None,  # [N, 3]
    camera_from_world: torch.Tensor,  # [C, 4, 4]
    camera: PinholeCamera,
    *,
    sh: torch.Tensor | None = None,  # [N, K, 3] in place of colours
    channels: torch.Tensor | None = None,  # [N, D]
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor | None]:
    """Colour ``[C, H, W, 3]``, accumulated depth ``[C, H, W]``, alpha ``[C, H, W]`` and channels ``[C, H, W, D]``.

    gsplat renders any number of per-Gaussian channels, but harmonics only alone: with both, the colours are worked out
    here for every camera.
    """
    from gsplat import rasterization

    degree = None
    if sh is None:
        assert colors is not None
        features = colors if channels is None else torch.cat([colors, channels], dim=-1)
    elif channels is None:
        features, degree = sh, TERMS.index(sh.shape[1])
    else:
        own = [evaluate_sh(sh, means - camera_centre(pose)) for pose in camera_from_world]
        features = torch.stack([torch.cat([of_camera, channels], dim=-1) for of_camera in own])  # [C, N, 3 + D]
    intrinsics = torch.tensor(camera.matrix, dtype=torch.float32, device=means.device)
    output, alpha, _ = rasterization(
        means, quaternions, torch.exp(log_scales), torch.sigmoid(opacity_logits), features, camera_from_world,
        intrinsics.expand(len(camera_from_world), 3, 3).contiguous(), camera.width, camera.height,
        near_plane=0.01, eps2d=0.3, sh_degree=degree, packed=False, render_mode="RGB+D",
    )  # fmt: skip
    extra = None if channels is None else output[..., 3:-1]
    return output[..., :3], output[..., -1], alpha[..., 0], extra
