"""Implement `Rasterizer` with torch's autograd: gsplat on a CUDA device, or the reference implementation.

A rendering copies the map to the device. The steps of a mapping event copy it once, and back at their end.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import torch

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera, invert_rigid
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.splatting import gsplat_backend
from activestructure_gym.splatting.api import rasterize
from activestructure_gym.splatting.cpu import LossWeights, Rendering, check_map, check_state
from activestructure_gym.splatting.layout import CHUNK
from activestructure_gym.splatting.torch_losses import adam, mapping_loss

_MAX_PAIRS = 30_000_000  # pixel-Gaussian pairs in a step of the reference, at 130 bytes each: 4 GB
# Camera-Gaussian pairs projected at once. gsplat keeps the visible ones, at about 0.5 kB each: 2 GB for a sixth.
_AT_ONCE = 25_000_000
# Rows of a map that hold one quantity: mean, quaternion, log-scale, opacity logit, colour.
_QUANTITIES = (slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 11), slice(11, 14))


class TorchRasterizer:
    """Implement `Rasterizer` with torch.

    The backend ``gsplat`` computes in float32 on the first CUDA device, ``reference`` in float64 on the host.
    """

    def __init__(self, backend: Literal["gsplat", "reference"]) -> None:
        self.backend = backend
        self.device = gsplat_backend.DEVICE if backend == "gsplat" else "cpu"
        self.dtype = torch.float32 if backend == "gsplat" else torch.float64

    def render(
        self,
        parameters: np.ndarray,  # [14, capacity] float32
        count: int,
        camera: PinholeCamera,
        world_from_camera: np.ndarray,  # [4, 4]
        *,
        unseen: np.ndarray | None = None,  # ignored
    ) -> Rendering:
        """Render colour, accumulated depth and alpha of one camera, as `cpu.render` does."""
        check_map(parameters, count)
        if not count:
            black = np.zeros((camera.height, camera.width, 3), np.float32)
            return Rendering(black, black[..., 0].copy(), black[..., 0].copy())
        with torch.no_grad():
            parts = self._quantities(parameters[:, :count])
            color, depth, alpha, _ = self.draw(parts, camera, self.poses(world_from_camera))
            images = _array(torch.cat([color[0], depth[0, ..., None], alpha[0, ..., None]], dim=-1))
        return Rendering(*(np.ascontiguousarray(image) for image in (images[..., :3], images[..., 3], images[..., 4])))

    def render_depth_alpha(
        self,
        parameters: np.ndarray,  # [14, capacity] float32
        count: int,
        camera: PinholeCamera,
        world_from_camera: np.ndarray,  # [C, 4, 4]
    ) -> tuple[np.ndarray, np.ndarray]:  # accumulated depth [C, H, W], alpha [C, H, W]
        """Render accumulated depth and alpha of many cameras, as `cpu.render_depth_alpha` does."""
        check_map(parameters, count)
        poses = np.asarray(world_from_camera, dtype=np.float64).reshape(-1, 4, 4)
        images = np.zeros((2, len(poses), camera.height, camera.width), np.float32)
        if not count or not len(poses):
            return images[0], images[1]
        at_once = max(1, _AT_ONCE // count)
        with torch.no_grad():
            parts, on_device = self._quantities(parameters[:, :count]), self.poses(poses)
            for first in range(0, len(poses), at_once):
                some = slice(first, first + at_once)
                if self.backend == "gsplat":
                    found = gsplat_backend.depth_alpha_gsplat(parts, on_device[some], camera)
                else:
                    found = torch.stack(self.draw(parts, camera, on_device[some])[1:3])
                images[:, some] = _array(found)
        return images[0], images[1]

    def render_values(
        self,
        parameters: np.ndarray,  # [14, capacity] float32
        count: int,
        camera: PinholeCamera,
        world_from_camera: np.ndarray,  # [C, 4, 4]
        values: np.ndarray,  # [N]
    ) -> np.ndarray:  # [C, H, W]
        """Render one number per Gaussian from many cameras, as `cpu.render_values` does."""
        painted = parameters.copy()
        painted[-3, :count] = values
        poses = np.asarray(world_from_camera, dtype=np.float64).reshape(-1, 4, 4)
        pictures = np.empty((len(poses), camera.height, camera.width), np.float32)
        for picture, pose in zip(pictures, poses):
            picture[:] = self.render(painted, count, camera, pose).color[..., 0]
        return pictures

    def begin(
        self,
        parameters: np.ndarray,  # [14, capacity] float32
        first_moment: np.ndarray,  # [14, capacity] float32
        second_moment: np.ndarray,  # [14, capacity] float32
        count: int,
        **options: Any,
    ) -> TorchSteps:
        """Copy a map to the device for the steps of a mapping event; ``options`` are those of `Rasterizer.begin`."""
        return TorchSteps(self, (parameters, first_moment, second_moment), count, **options)

    def draw(
        self,
        parts: Sequence[torch.Tensor],  # [N, D] each, see `_QUANTITIES`
        camera: PinholeCamera,
        camera_from_world: torch.Tensor,  # [C, 4, 4]
        channels: torch.Tensor | None = None,  # [N, D]
        *,
        centre_depth: bool = False,
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Return colour [C, H, W, 3], accumulated depth and alpha [C, H, W], and channels [C, H, W, D] or None."""
        means, quaternions, log_scales, logits, colors = parts
        if self.backend == "gsplat":
            return gsplat_backend.rasterize_gsplat(
                means, quaternions, log_scales, logits[:, 0], colors, camera_from_world, camera,
                channels=channels, centre_depth=centre_depth,
            )  # fmt: skip
        picture = rasterize(
            means, quaternions, log_scales, logits[:, 0], colors, camera_from_world=camera_from_world, camera=camera,
            channels=channels, centre_depth=centre_depth, backend="reference",
        )  # fmt: skip
        return picture.color, picture.depth, picture.alpha, picture.channels

    def tensor(self, array: np.ndarray) -> torch.Tensor:
        """Copy an array to the device, as floating-point numbers unless it is of bool or uint8."""
        dtype = None if array.dtype in (np.bool_, np.uint8) else self.dtype
        return torch.tensor(array, dtype=dtype, device=self.device)

    def poses(self, world_from_camera: np.ndarray) -> torch.Tensor:  # [4, 4] or [C, 4, 4] -> [C, 4, 4]
        """Copy the inverses of poses to the device."""
        return self.tensor(invert_rigid(np.asarray(world_from_camera, dtype=np.float64).reshape(-1, 4, 4)))

    def _quantities(self, rows: np.ndarray) -> list[torch.Tensor]:  # [..., 14, N] -> [..., N, D] each
        columns = self.tensor(rows).transpose(-1, -2)
        return [columns[..., part].contiguous() for part in _QUANTITIES]


class TorchSteps:
    """Hold a map on the device during the optimiser steps of a mapping event; implements `rasterizers.Steps`.

    No step waits for the device: losses are read at `end`, and images of a keyframe are copied at its first step.
    """

    def __init__(
        self,
        rasterizer: TorchRasterizer,
        state: tuple[np.ndarray, np.ndarray, np.ndarray],  # parameters and moments, [14, capacity] each
        count: int,
        *,
        weights: LossWeights,
        beta1: float = 0.9,
        beta2: float = 0.999,
        isotropic: bool = False,
    ) -> None:
        check_map(state[0], count)
        check_state(*state)
        self._rasterizer, self._host, self._count = rasterizer, state, count
        self._weights, self._betas, self._isotropic = weights, (beta1, beta2), isotropic
        self._parts = rasterizer._quantities(np.stack([array[:, :count] for array in state]))  # [3, N, D] each
        # Channels that are 0 everywhere change no image. The gradient of their sum is the weight of each Gaussian in
        # the image. There are two, since gsplat then has kernels for the number of channels.
        self._nothing = self._parts[0].new_zeros((count, 2)).requires_grad_()
        self._targets: dict[int, tuple[Frame, torch.Tensor, torch.Tensor, torch.Tensor]] = {}  # by id of the frame
        self._losses: list[torch.Tensor] = []
        self._adam = adam
        if rasterizer.backend == "gsplat":
            from gsplat.cuda._wrapper import adam as compiled

            self._adam = compiled

    def step(
        self,
        frame: Frame,
        *,
        learning_rates: np.ndarray,  # [14] float32
        epsilon: float = 1e-15,
        unseen: np.ndarray | None = None,  # [chunks] bool: neither rendered nor changed
    ) -> None:
        """Take one optimiser step on the loss of a frame, as `cpu.mapping_step` does.

        Raises `InputError` if image and map are too large for the reference, `ValueError` if the rows of a quantity
        have different learning rates.
        """
        one, camera = self._rasterizer, frame.camera
        pairs = self._count * camera.width * camera.height
        if one.backend == "reference" and pairs > _MAX_PAIRS:
            raise InputError(
                f"splatting backend 'reference' compares every pixel with every Gaussian, at most {_MAX_PAIRS:,} "
                f"pairs in a step, and {camera.width} x {camera.height} pixels with {self._count:,} Gaussians make "
                f"{pairs:,}; use mapper.backend=cpu or a smaller image."
            )
        rates = [float(learning_rates[part.start]) for part in _QUANTITIES]
        if any(np.ptp(learning_rates[part]) for part in _QUANTITIES):
            raise ValueError(f"the rows of a quantity must have one learning rate, got {learning_rates}")
        _, pose, rgb, depth = self._target(frame)
        leaves = [part[0].detach().requires_grad_() for part in self._parts]
        drawn = list(leaves)
        if unseen is not None:
            hidden = one.tensor(unseen).repeat_interleave(CHUNK)[: self._count, None]
            drawn[3] = leaves[3].masked_fill(hidden, -torch.inf)
        color, shown, alpha, blended = one.draw(
            drawn, camera, pose, self._nothing, centre_depth=self._weights.centre_depth
        )
        loss = mapping_loss(color[0], shown[0], alpha[0], rgb, depth, self._weights)
        assert blended is not None
        *gradients, weight = torch.autograd.grad(loss.total + blended.sum(), (*leaves, self._nothing))
        if self._isotropic:
            gradients[2] = gradients[2].sum(dim=1, keepdim=True).expand(-1, 3)
        seen = weight[:, 0] > 0
        for part, gradient, rate in zip(self._parts, gradients, rates):
            self._adam(part[0], gradient.contiguous(), part[1], part[2], seen, rate, *self._betas, epsilon)
        self._losses.append(loss.terms)

    def end(self) -> np.ndarray:  # [steps, 3] float64
        """Copy the map back to its arrays; return colour loss, depth loss in metres and SSIM of each step."""
        if not self._losses:
            return np.zeros((0, 3))
        for array, values in zip(self._host, _array(torch.cat(self._parts, dim=-1).transpose(1, 2))):
            array[:, : self._count] = values
        return torch.stack(self._losses).to("cpu", torch.float64).numpy()

    def _target(self, frame: Frame) -> tuple[Frame, torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return the frame, its pose [1, 4, 4], colours [H, W, 3] in 0..1 and depth [H, W] on the device."""
        if id(frame) not in self._targets:
            one = self._rasterizer
            rgb = one.tensor(frame.rgb).to(one.dtype) * float(np.float32(1.0 / 255.0))
            self._targets[id(frame)] = frame, one.poses(frame.world_from_camera), rgb, one.tensor(frame.depth)
        return self._targets[id(frame)]


def _array(tensor: torch.Tensor) -> np.ndarray:  # float32
    return tensor.detach().to("cpu", torch.float32).numpy()
