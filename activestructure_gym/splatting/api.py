"""One differentiable function over three implementations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from activestructure_gym.errors import InputError, unknown_name
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.splatting.backends import BACKENDS, backend_status
from activestructure_gym.splatting.reference import rasterize_reference
from activestructure_gym.splatting.workspace import Lease, fitted

_Tensors = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]


@dataclass(frozen=True)
class Rasterization:
    """Pictures of one camera, or of C cameras with a leading axis."""

    color: torch.Tensor  # [..., H, W, 3]
    depth: torch.Tensor  # [..., H, W] accumulated: sum of weight times depth
    alpha: torch.Tensor  # [..., H, W]

    @property
    def expected_depth(self) -> torch.Tensor:  # [..., H, W]
        """Metres: accumulated depth over alpha, 0 where nothing was hit."""
        return self.depth / self.alpha.clamp_min(1e-10)


def rasterize(
    means: torch.Tensor,  # [N, 3] metres, world
    quaternions: torch.Tensor,  # [N, 4] wxyz, any length > 0
    log_scales: torch.Tensor,  # [N, 3]
    opacity_logits: torch.Tensor,  # [N]
    colors: torch.Tensor,  # [N, 3]
    *,
    camera_from_world: torch.Tensor,  # [4, 4] or [C, 4, 4]
    camera: PinholeCamera,
    backend: str = "auto",
    max_alpha: float = 0.999,
) -> Rasterization:
    """Render Gaussians, with gradients to every tensor given.

    ``backend`` is ``cpu``, ``gsplat``, ``reference`` or ``auto`` (gsplat for CUDA tensors, the compiled kernel for
    float32 on the CPU, the reference for anything else).

    Raises:
        InputError: an unknown backend, or one that cannot run here.
    """
    if backend == "auto":
        backend = "gsplat" if means.is_cuda else "cpu" if means.dtype == torch.float32 else "reference"
    if backend not in BACKENDS:
        raise unknown_name("splatting backend", backend, BACKENDS)
    if not 0.0 < max_alpha < 1.0:
        raise ValueError(f"max_alpha must lie in (0, 1), got {max_alpha}")
    tensors = (means, quaternions, log_scales, opacity_logits, colors)
    render = _RENDERERS[backend]
    if camera_from_world.dim() == 2:
        return Rasterization(*render(tensors, camera_from_world, camera, max_alpha))
    pictures = [render(tensors, pose, camera, max_alpha) for pose in camera_from_world]
    return Rasterization(*(torch.stack(channel) for channel in zip(*pictures)))


def _render_reference(tensors: _Tensors, camera_from_world: torch.Tensor, camera: PinholeCamera, max_alpha: float):
    return rasterize_reference(*tensors, camera_from_world, camera, max_alpha=max_alpha)


def _render_gsplat(tensors: _Tensors, camera_from_world: torch.Tensor, camera: PinholeCamera, max_alpha: float):
    status = backend_status()["gsplat"]
    if status != "works":
        raise InputError(f"splatting backend 'gsplat' cannot run here ({status}); use backend='cpu'.")
    if max_alpha != 0.999:
        raise InputError(f"gsplat has its alpha limit compiled in as 0.999, got {max_alpha}; use backend='cpu'.")
    from activestructure_gym.splatting.gsplat_backend import rasterize_gsplat

    return rasterize_gsplat(*tensors, camera_from_world, camera)


def _render_cpu(tensors: _Tensors, camera_from_world: torch.Tensor, camera: PinholeCamera, max_alpha: float):
    for tensor in (*tensors, camera_from_world):
        if tensor.dtype != torch.float32 or tensor.is_cuda:
            raise InputError(
                f"splatting backend 'cpu' takes float32 tensors on the CPU, got {tensor.dtype} on {tensor.device}; "
                "use backend='reference' or convert them."
            )
    means, quaternions, log_scales, opacity_logits, colors = tensors
    parameters = torch.cat([means.T, quaternions.T, log_scales.T, opacity_logits[None], colors.T])
    return _CpuRasterization.apply(parameters, camera_from_world, camera, max_alpha)


_RENDERERS = {"cpu": _render_cpu, "gsplat": _render_gsplat, "reference": _render_reference}


class _CpuRasterization(torch.autograd.Function):
    """The compiled kernel as a node of torch's graph: parameters ``[14, N]`` and camera_from_world in, images out."""

    @staticmethod
    def forward(ctx, parameters, camera_from_world, camera, max_alpha):
        ctx.count = parameters.shape[1]
        ctx.lease = Lease()
        ctx.lease.workspace.render(
            fitted(parameters.detach().contiguous().numpy()), ctx.count, camera, camera_from_world.detach().numpy(),
            max_alpha=max_alpha,
        )  # fmt: skip
        return tuple(torch.from_numpy(picture) for picture in ctx.lease.workspace.pictures())

    @staticmethod
    def backward(ctx, by_color, by_depth, by_alpha):
        workspace = ctx.lease.workspace
        workspace.set_gradient_images(by_color.numpy(), by_depth.numpy(), by_alpha.numpy())
        gradient, by_camera = torch.zeros(workspace.parameters.shape), torch.zeros(4, 4)
        array = gradient.numpy()
        by_camera[:3] = torch.from_numpy(workspace.backward(np.zeros(18, np.float32), array, array, array))
        return gradient[:, : ctx.count], by_camera, None, None
