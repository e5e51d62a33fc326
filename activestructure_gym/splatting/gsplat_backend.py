"""The same picture from gsplat on a CUDA device (extra ``gpu``)."""

from __future__ import annotations

import torch

from activestructure_gym.geometry import PinholeCamera


def rasterize_gsplat(
    means: torch.Tensor,  # [N, 3]
    quaternions: torch.Tensor,  # [N, 4] wxyz
    log_scales: torch.Tensor,  # [N, 3]
    opacity_logits: torch.Tensor,  # [N]
    colors: torch.Tensor,  # [N, 3]
    camera_from_world: torch.Tensor,  # [4, 4]
    camera: PinholeCamera,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:  # colour [H, W, 3], accumulated depth [H, W], alpha [H, W]
    """Render one camera. gsplat's alpha limit is compiled in (0.999)."""
    from gsplat import rasterization

    intrinsics = torch.tensor(camera.matrix, dtype=torch.float32, device=means.device)
    output, alpha, _ = rasterization(
        means, quaternions, torch.exp(log_scales), torch.sigmoid(opacity_logits), colors,
        camera_from_world[None], intrinsics[None], camera.width, camera.height,
        near_plane=0.01, eps2d=0.3, packed=False, render_mode="RGB+D",
    )  # fmt: skip
    return output[0, ..., :3], output[0, ..., 3], alpha[0, ..., 0]
