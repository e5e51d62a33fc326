"""Make the CPU kernels one node of torch's autograd graph.

Parameters are converted by `packing` in both directions, without a copy if the tensors have the memory layout of the
kernels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch

from activestructure_gym.compiling.thread_team import default_threads
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.splatting import layout, passes
from activestructure_gym.splatting.packing import packed, unpacked
from activestructure_gym.splatting.spherical_harmonics import shade, unshade
from activestructure_gym.splatting.workspace import PooledWorkspace, make_grid, make_view

_TO_GRADIENT, _TO_POSE = np.zeros((2, layout.RATES), np.float32)
_TO_GRADIENT[layout.MODE], _TO_POSE[layout.MODE] = layout.TO_GRADIENT, layout.POSE_ONLY


@dataclass(frozen=True)
class CpuOptions:
    """Hold the arguments of a rendering that are not tensors; see `api.rasterize`."""

    camera: PinholeCamera
    max_alpha: float
    centre_depth: bool
    blur_variance: float  # px^2
    median_depth: bool
    threads: int | None


class _Given(NamedTuple):
    """Hold the tensors of a rendering; see `api.rasterize`.

    They are separate arguments of the autograd function, because torch tracks only these.
    """

    means: torch.Tensor  # [N, 3]
    quaternions: torch.Tensor  # [N, 4]
    log_scales: torch.Tensor  # [N, 3]
    opacity_logits: torch.Tensor  # [N]
    colors: torch.Tensor | None  # [N, 3]
    sh: torch.Tensor | None  # [N, K, 3]
    channels: torch.Tensor | None  # [N, D]
    camera_from_world: torch.Tensor  # [4, 4] or [C, 4, 4]


class CpuRasterization(torch.autograd.Function):
    """Compute colour, depth, alpha, channels and median depth of one or several cameras.

    Images that were not requested are None.
    """

    @staticmethod
    def forward(ctx: Any, options: CpuOptions, *tensors: Any) -> Any:
        """Render the images; ``tensors`` are the fields of `_Given`, in order."""
        ctx.save_for_backward(*tensors)
        ctx.set_materialize_grads(False)
        given = _Given(*tensors)
        camera, count, sh, channels = options.camera, len(given.means), given.sh, given.channels
        ctx.threads = options.threads or default_threads()
        poses = given.camera_from_world.detach().numpy().reshape(-1, 4, 4)
        ctx.parameters = packed(_detached(given), ctx.threads)
        coefficients = None if sh is None else sh.detach().contiguous().numpy()
        features = None if channels is None else channels.detach().contiguous().numpy()
        pictures, ctx.rendered = [], []
        goes_back = any(ctx.needs_input_grad)
        for pose in poses:
            pooled = PooledWorkspace()
            workspace = pooled.workspace
            if coefficients is not None:
                view = make_view(camera, pose, blur_variance=options.blur_variance)
                grid = make_grid(count, ctx.parameters.shape[1], camera)
                shade(ctx.parameters, coefficients, pose, view, grid, ctx.threads)
            workspace.render(
                ctx.parameters, count, camera, pose, max_alpha=options.max_alpha, centre_depth=options.centre_depth,
                blur_variance=options.blur_variance, threads=ctx.threads, keep=goes_back,
            )  # fmt: skip
            own = list(workspace.pictures())
            kept: list[np.ndarray] = []
            if features is not None:
                picture, kept = passes.blend_channels(workspace, features)
                own.append(picture)
            if options.median_depth:
                own.append(passes.median_depth(workspace))
            pictures.append(own)
            if goes_back:
                ctx.rendered.append((pooled, kept))
        if given.camera_from_world.dim() == 2:
            outputs = [torch.from_numpy(picture) for picture in pictures[0]]
        else:
            outputs = [torch.from_numpy(np.stack(of_cameras)) for of_cameras in zip(*pictures)]
        color, depth, alpha = outputs[:3]
        extra = None if features is None else outputs[3]
        median = outputs[-1] if options.median_depth else None
        if median is not None:
            ctx.mark_non_differentiable(median)
        return color, depth, alpha, extra, median

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, by_color, by_depth, by_alpha, by_extra, _):
        """Return the gradients of the inputs of `forward`, given the gradients of its images.

        The median depth has none.
        """
        given = _Given(*ctx.saved_tensors)  # torch raises an error if a tensor was changed in place
        sh, channels, camera_from_world = given.sh, given.channels, given.camera_from_world
        cameras, batched = len(ctx.rendered), camera_from_world.dim() == 3
        poses = camera_from_world.detach().numpy().reshape(-1, 4, 4)
        coefficients = None if sh is None else sh.detach().contiguous().numpy()
        features = None if channels is None else channels.detach().contiguous().numpy()
        still = sh is None and channels is None and not any(ctx.needs_input_grad[1:6])  # only the pose needs a gradient
        total = torch.zeros(ctx.parameters.shape).numpy()  # torch reuses memory, and numpy would allocate new memory
        by_sh = torch.zeros(sh.shape if sh is not None else 0)
        by_channels = torch.zeros(channels.shape if channels is not None else 0)
        by_pose = np.zeros((cameras, 4, 4), np.float32)
        part = total
        for index, (pooled, kept) in enumerate(ctx.rendered):
            workspace, own_pose = pooled.workspace, by_pose[index, :3]
            if index:
                part = np.zeros_like(part)
            own = [
                None if gradient is None else gradient.numpy()[index] if batched else gradient.numpy()
                for gradient in (by_color, by_depth, by_alpha, by_extra)
            ]
            if any(gradient is not None for gradient in own[:3]):
                workspace.set_gradient_images(*_filled(own[:3], workspace.camera))
                own_pose += workspace.backward(_TO_POSE if still else _TO_GRADIENT, part, part, part)
                if coefficients is not None:
                    own_pose += unshade(
                        ctx.parameters, coefficients, poses[index], workspace.grid, part, by_sh.numpy(), ctx.threads
                    )
            if features is not None and own[3] is not None:
                own_pose += passes.unblend_channels(workspace, features, kept, own[3], part, by_channels.numpy())
            if index:
                total += part
        by_parameters = [None] * 5 if still else unpacked(total, _detached(given), ctx.threads)
        return (
            None,
            *by_parameters,
            None if sh is None else by_sh,
            None if channels is None else by_channels,
            torch.from_numpy(by_pose).reshape(camera_from_world.shape),
        )


def _detached(given: _Given) -> tuple[torch.Tensor | None, ...]:
    """Return means, quaternions, log-scales, opacity logits and colours without their autograd history."""
    return tuple(None if tensor is None else tensor.detach() for tensor in given[:5])


def _filled(images: list[np.ndarray | None], camera: PinholeCamera) -> list[np.ndarray]:
    """Return the gradient images of colour, depth and alpha, with zeros for images that the loss does not use."""
    shapes = ((camera.height, camera.width, 3), (camera.height, camera.width), (camera.height, camera.width))
    return [np.zeros(shape, np.float32) if image is None else image for image, shape in zip(images, shapes)]
