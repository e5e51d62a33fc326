"""The same pictures from gsplat on a CUDA device (extra ``gpu``)."""

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

    features, degree = colors, None
    if sh is not None and channels is None:
        features, degree = sh, TERMS.index(sh.shape[1])
    elif sh is not None:
        features = torch.stack([evaluate_sh(sh, means - camera_centre(pose)) for pose in camera_from_world])
    if channels is not None:
        own = channels if features.dim() == 2 else channels.expand(len(camera_from_world), -1, -1)
        features = torch.cat([features, own], dim=-1)
    intrinsics = torch.tensor(camera.matrix, dtype=torch.float32, device=means.device)
    output, alpha, _ = rasterization(
        means, quaternions, torch.exp(log_scales), torch.sigmoid(opacity_logits), features, camera_from_world,
        intrinsics.expand(len(camera_from_world), 3, 3).contiguous(), camera.width, camera.height,
        near_plane=0.01, eps2d=0.3, sh_degree=degree, packed=False, render_mode="RGB+D",
    )  # fmt: skip
    extra = None if channels is None else output[..., 3:-1]
    return output[..., :3], output[..., -1], alpha[..., 0], extra
