"""Implement `Rasterizer` with torch's autograd: gsplat on a CUDA device, or the reference implementation.

The map remains on the host. Each call copies the used columns to the device, and a step copies the changed columns
back.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import torch

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera, invert_rigid
from activestructure_gym.splatting import gsplat_backend
from activestructure_gym.splatting.api import rasterize
from activestructure_gym.splatting.cpu import LossWeights, Rendering, StepLosses, check_map, check_step
from activestructure_gym.splatting.layout import CHUNK
from activestructure_gym.splatting.torch_losses import Adam, mapping_loss

_MAX_PAIRS = 30_000_000  # pixel-Gaussian pairs in a step of the reference, at 130 bytes each: 4 GB
_AT_ONCE = 4_000_000  # camera-Gaussian pairs projected at once: about 2 GB


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
            rows = self._tensor(parameters[:, :count])
            color, depth, alpha, _ = self._draw(rows, camera, np.asarray(world_from_camera)[None])
        return Rendering(_array(color[0]), _array(depth[0]), _array(alpha[0]))

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
        depths, alphas = (np.zeros((len(poses), camera.height, camera.width), np.float32) for _ in range(2))
        if not count:
            return depths, alphas
        at_once = max(1, _AT_ONCE // count)
        with torch.no_grad():
            rows = self._tensor(parameters[:, :count])
            for first in range(0, len(poses), at_once):
                some = slice(first, first + at_once)
                _, depth, alpha, _ = self._draw(rows, camera, poses[some])
                depths[some], alphas[some] = _array(depth), _array(alpha)
        return depths, alphas

    def mapping_step(
        self,
        parameters: np.ndarray,  # [14, capacity] float32, changed in place
        first_moment: np.ndarray,  # [14, capacity] float32, changed in place
        second_moment: np.ndarray,  # [14, capacity] float32, changed in place
        count: int,
        camera: PinholeCamera,
        world_from_camera: np.ndarray,  # [4, 4]
        target_rgb: np.ndarray,  # [H, W, 3] float32 0..1
        target_depth: np.ndarray,  # [H, W] float32 metres, 0 = no return
        *,
        weights: LossWeights,
        learning_rates: np.ndarray,  # [14] float32
        beta1: float = 0.9,
        beta2: float = 0.999,
        epsilon: float = 1e-15,
        isotropic: bool = False,
        unseen: np.ndarray | None = None,  # [chunks] bool: neither rendered nor changed
    ) -> StepLosses:
        """Take one optimiser step on the loss of one image, as `cpu.mapping_step` does.

        Raises `InputError` if image and map are too large for the reference.
        """
        state = (parameters, first_moment, second_moment)
        check_map(parameters, count)
        check_step(*state, learning_rates, isotropic=isotropic)
        pairs = count * camera.width * camera.height
        if self.backend == "reference" and pairs > _MAX_PAIRS:
            raise InputError(
                f"splatting backend 'reference' compares every pixel with every Gaussian, at most {_MAX_PAIRS:,} "
                f"pairs in a step, and {camera.width} x {camera.height} pixels with {count:,} Gaussians make "
                f"{pairs:,}; use mapper.backend=cpu or a smaller image."
            )
        drawn = np.arange(count) if unseen is None else np.flatnonzero(~np.repeat(unseen, CHUNK)[:count])
        targets = self._tensor(target_rgb), self._tensor(target_depth)
        if not len(drawn):
            black = torch.zeros_like(targets[0])
            loss = mapping_loss(black, black[..., 0], black[..., 0], *targets, weights)
            return StepLosses(loss.color, loss.depth, loss.ssim)
        rows = self._tensor(parameters[:, drawn]).requires_grad_()
        # A channel that is 0 everywhere changes no image. The gradient of its sum is the weight of each Gaussian in the
        # image.
        nothing = torch.zeros((len(drawn), 1), dtype=self.dtype, device=self.device, requires_grad=True)
        color, depth, alpha, blended = self._draw(
            rows, camera, np.asarray(world_from_camera)[None], nothing, centre_depth=weights.centre_depth
        )
        loss = mapping_loss(color[0], depth[0], alpha[0], *targets, weights)
        assert blended is not None
        gradient, weight = torch.autograd.grad(loss.total + blended.sum(), (rows, nothing))
        seen = torch.nonzero(weight[:, 0] > 0)[:, 0]
        gradient, columns = gradient[:, seen], drawn[seen.cpu().numpy()]
        if isotropic:
            gradient[7:10] = gradient[7:10].sum(dim=0)
        adam = Adam(learning_rates, beta1, beta2, epsilon)
        stepped = adam.step(gradient, *(self._tensor(array[:, columns]) for array in state))
        for array, values in zip(state, stepped):
            array[:, columns] = _array(values)
        return StepLosses(loss.color, loss.depth, loss.ssim)

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.tensor(array, dtype=self.dtype, device=self.device)

    def _draw(
        self,
        rows: torch.Tensor,  # [14, N]
        camera: PinholeCamera,
        world_from_camera: np.ndarray,  # [C, 4, 4]
        channels: torch.Tensor | None = None,  # [N, D]
        *,
        centre_depth: bool = False,
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Return colour [C, H, W, 3], accumulated depth and alpha [C, H, W], and channels [C, H, W, D] or None."""
        poses = self._tensor(invert_rigid(np.asarray(world_from_camera, dtype=np.float64)))
        means, quaternions, log_scales, logits, colors = rows[:3].T, rows[3:7].T, rows[7:10].T, rows[10], rows[11:].T
        if self.backend == "gsplat":
            return gsplat_backend.rasterize_gsplat(
                means.contiguous(), quaternions.contiguous(), log_scales.contiguous(), logits.contiguous(),
                colors.contiguous(), poses, camera, channels=channels, centre_depth=centre_depth,
            )  # fmt: skip
        picture = rasterize(
            means, quaternions, log_scales, logits, colors,
            camera_from_world=poses, camera=camera, channels=channels, centre_depth=centre_depth, backend="reference",
        )  # fmt: skip
        return picture.color, picture.depth, picture.alpha, picture.channels


def _array(tensor: torch.Tensor) -> np.ndarray:  # float32
    return tensor.detach().to("cpu", torch.float32).numpy()
