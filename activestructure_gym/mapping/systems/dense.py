"""Map with torch: gradients from autograd, and Adam steps on all Gaussians, visible or not.

This is the common part of MonoGS and Gaussian-SLAM with given poses. A mapping event adds seeds from the new keyframe,
takes optimiser steps, and prunes.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import torch
from scipy.spatial import cKDTree

from activestructure_gym.geometry import invert_rigid
from activestructure_gym.geometry.frame import Frame, unit_rgb
from activestructure_gym.mapping.base import MappingReport
from activestructure_gym.mapping.downsampling import reduced
from activestructure_gym.mapping.gaussian_map import OPACITY_LOGIT, ROWS
from activestructure_gym.mapping.keyframe_mapper import KeyframeMapper, checked_frame, report_of
from activestructure_gym.mapping.systems.dense_config import DenseConfig
from activestructure_gym.splatting import LossWeights, gsplat_backend
from activestructure_gym.splatting.api import Rasterization, rasterize
from activestructure_gym.splatting.torch_losses import MappingLoss, mapping_loss

# Function from a rendering, true colours [H, W, 3] and measured depth [H, W] in metres to the loss of an image.
ViewLoss = Callable[[Rasterization, torch.Tensor, torch.Tensor], MappingLoss]

_NEIGHBOURS = 3  # nearest points whose distance gives the size of a seed
# Loss of colours only, as in 3D Gaussian splatting ([kerbl2023]). Both systems refine a finished map with it.
_REFINING = LossWeights(image=1.0, l1_share=0.8, depth=0.0, normalised_depth=False)


class DenseMapper(KeyframeMapper):
    """Define a mapper whose steps change every Gaussian. Subclasses define the seeds and the steps of an event."""

    config: DenseConfig

    @abstractmethod
    def _seeds(self, frame: Frame) -> tuple[np.ndarray, float]:
        """Return the seeds [14, n] for a new frame, and the share of its pixels that are missing in the map."""

    @abstractmethod
    def _event(self, index: int, iterations: int) -> tuple[list[int], np.ndarray, int]:
        """Optimise the map after keyframe ``index`` was added.

        Returns the keyframe of each loss, the losses [views, 3] (colour, depth, ssim), and the number of Gaussians
        pruned.
        """

    def observe(self, frame: Frame, *, iterations: int | None = None) -> MappingReport:
        """Add a keyframe, seed by the rule of the system, and take optimiser steps (default: ``config.iterations``)."""
        frame = checked_frame(frame)
        iterations = self.config.iterations if iterations is None else iterations
        self.events += 1
        with one_thread():
            block, new_share = self._seeds(frame)
            added, left_out = self._append(block)
            index = self._store.append(reduced(frame, self.config.keyframe_reduction), new_share=new_share)
            self._before_steps()
            views, losses, pruned = self._event(index, iterations)
            self._after_steps()
        self._measure_psnr(self._store.stalest(1))
        return report_of(
            self.map.count,
            views,
            losses,
            pruned,
            added=added,
            left_out=left_out,
            new_share=new_share,
            psnr=self._store.psnr[index],
        )

    def refine(self, iterations: int, *, keyframe_indices: Sequence[int] | None = None) -> MappingReport:
        """Optimise all Gaussians on the colours of all or the given keyframes, in ``iterations`` steps.

        The keyframes are shuffled repeatedly.
        """
        views = self._shuffled_views(iterations, keyframe_indices)
        self.events += 1
        losses = np.full((len(views), 3), np.nan)
        with one_thread():
            self._before_steps()
            self.map.reset_moments()
            for step, view in enumerate(views):
                rows = leaf(self.map.parameters[:, : self.map.count])
                losses[step] = self._add_loss(rows, view, _refining_loss)
                self._step(rows, slice(0, self.map.count), self.config.learning_rates(), step + 1)
            self._after_steps()
        return report_of(self.map.count, views, losses, 0)

    def _append(self, block: np.ndarray) -> tuple[int, int]:
        """Insert Gaussians ``block`` [14, n], or an even selection if ``max_gaussians`` does not allow all.

        Returns the number inserted and the number left out.
        """
        bound, count = self.config.max_gaussians, block.shape[1]
        room = count if bound is None else min(count, max(0, bound - self.map.count))
        if room < count:
            block = block[:, np.linspace(0, count, room, endpoint=False, dtype=int)]
        self.map.append(block)
        return room, count - room

    def _add_loss(self, rows: torch.Tensor, view: int, compare: ViewLoss) -> tuple[float, float, float]:
        """Add the gradient of a keyframe's loss to ``rows`` [14, n].

        Return colour error, depth error in metres and SSIM.
        """
        frame = self.keyframes[view]
        shown = drawn(rows, frame, self.config)
        loss = compare(
            shown, torch.from_numpy(unit_rgb(frame)).to(shown.color), torch.from_numpy(frame.depth).to(shown.color)
        )
        loss.total.backward()  # type: ignore[no-untyped-call]
        color, depth, similarity = loss.terms.tolist()
        return color, depth, similarity

    def _step(
        self,
        rows: torch.Tensor,  # [14, n] parameters with their gradient
        columns: slice,  # columns of the map from which ``rows`` was copied
        rates: np.ndarray,  # [14] learning rates
        number: int | np.ndarray,  # steps since the moments were 0; [14] if they differ by row
    ) -> None:
        config, gaussians = self.config, self.map
        assert rows.grad is not None
        adam_step(
            gaussians.parameters[:, columns],
            gaussians.first_moment[:, columns],
            gaussians.second_moment[:, columns],
            rows.grad.cpu().numpy(),
            rates=rates,
            number=number,
            betas=(config.adam_beta1, config.adam_beta2),
            epsilon=config.adam_epsilon,
        )
        gaussians.touched()

    def _transparent(self, threshold: float, start: int = 0) -> np.ndarray:  # [count] bool
        """Return a mask of the Gaussians from column ``start`` on whose opacity is below a threshold or not finite."""
        logits = self.map.parameters[OPACITY_LOGIT, : self.map.count]
        with np.errstate(divide="ignore"):  # the thresholds 0 and 1 give infinite logits
            least = np.log(threshold) - np.log1p(-threshold)
        return (np.arange(self.map.count) >= start) & ~(logits >= least)


def _refining_loss(shown: Rasterization, rgb: torch.Tensor, depth: torch.Tensor) -> MappingLoss:
    return mapping_loss(shown.color, shown.depth, shown.alpha, rgb, depth, _REFINING)


def leaf(parameters: np.ndarray) -> torch.Tensor:  # [14, n] -> [14, n]
    """Return a copy of the parameters that requires a gradient, in the memory layout that the kernels need."""
    count = parameters.shape[1]
    padded = np.zeros((ROWS, -(-max(1, count) // 16) * 16), np.float32)
    padded[:, :count] = parameters
    return torch.from_numpy(padded)[:, :count].requires_grad_()


def drawn(rows: torch.Tensor, frame: Frame, config: DenseConfig) -> Rasterization:
    """Render Gaussians ``rows`` [14, n] from the pose of a keyframe, differentiably."""
    pose = torch.from_numpy(invert_rigid(frame.world_from_camera)).to(rows)
    if config.backend == "gsplat":
        rows, pose = rows.to(gsplat_backend.DEVICE), pose.to(gsplat_backend.DEVICE)
    return rasterize(
        rows[:3].T,
        rows[3:7].T,
        rows[7:10].T,
        rows[10],
        rows[11:].T,
        camera_from_world=pose,
        camera=frame.camera,
        centre_depth=config.centre_depth,
        backend=config.backend,
    )


def roundness(rows: torch.Tensor) -> torch.Tensor:  # [14, n] -> metres
    """Return the mean difference between a scale and the mean scale of its Gaussian, in metres ([monogs, code]).

    ``rows`` [14, n] are the parameters of n Gaussians. The result is 0 if all are balls.
    """
    scales = rows[7:10].exp()
    return (scales - scales.mean(dim=0)).abs().mean()


def adam_step(
    parameters: np.ndarray,  # [14, n], changed in place
    first_moment: np.ndarray,  # [14, n], changed in place
    second_moment: np.ndarray,  # [14, n], changed in place
    gradient: np.ndarray,  # [14, n]
    *,
    rates: np.ndarray,  # [14] learning rates
    number: int | np.ndarray,  # steps since the moments were 0; [14] if they differ by row
    betas: tuple[float, float],  # decay rates of first and second moment
    epsilon: float,
) -> None:
    """Take one Adam step with bias correction ([adam], algorithm 1), equal to a step of `torch.optim.Adam`."""
    first, second = betas
    count = np.broadcast_to(np.asarray(number, np.float64), ROWS)[:, None]
    first_moment += np.float32(1.0 - first) * (gradient - first_moment)
    second_moment += np.float32(1.0 - second) * (np.square(gradient) - second_moment)
    size = (rates.astype(np.float64)[:, None] / (1.0 - first**count)).astype(np.float32)
    root = np.sqrt(second_moment / (1.0 - second**count).astype(np.float32))
    parameters -= size * first_moment / (root + np.float32(epsilon))


def spacing_squared(points: np.ndarray, around: np.ndarray) -> np.ndarray:  # [n, 3], [m, 3] -> [n] m^2
    """Return the mean squared distance of each point to its three nearest neighbours in ``around``.

    ``around`` must contain the points themselves. The result is nan if it has fewer than two.
    """
    if len(around) < 2:
        return np.full(len(points), np.nan)
    nearest = min(_NEIGHBOURS + 1, len(around))
    distances, _ = cKDTree(around).query(points, k=nearest)
    return np.square(distances[:, 1:]).mean(axis=1)


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit torch to one thread during the block, so that rounding does not depend on the number of cores."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
