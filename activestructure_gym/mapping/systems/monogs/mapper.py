"""Map with MonoGS, depth and given poses ([monogs, code]): every optimiser step renders a window of keyframes.

Every keyframe adds seeds, even on mapped surfaces. Gaussians that do not become opaque are pruned.

Differences from [monogs, code]:

- Poses and exposure are not optimised.
- The agent chooses the keyframes.
- Gaussians are not cloned or split, and opacities are not reset (there every 2001 steps).
- The overlap of two keyframes counts Gaussians with their mean close to the measured depth of both. The original counts
  Gaussians blended in both images.
- Gaussians are not pruned by their radius in pixels. They are tested after `prune_after` steps, since there are fewer
  steps per keyframe than the original's 150.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from activestructure_gym.geometry import invert_rigid, transform_points
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping.base import MappingReport
from activestructure_gym.mapping.gaussian_map import LOG_SCALE, MEAN, ROWS
from activestructure_gym.mapping.seeding import pixel_samples, seed_balls
from activestructure_gym.mapping.systems.dense import DenseMapper, leaf, roundness, spacing_squared
from activestructure_gym.mapping.systems.monogs.config import MonoGSConfig
from activestructure_gym.splatting.api import Rasterization
from activestructure_gym.splatting.torch_losses import MappingLoss

_NEWEST = 2  # newest keyframes that always remain in the window
# Pixels with a smaller sum of the three colours have no colour error; also the smallest depth compared, metres.
_DARK = 0.01
_MIN_SPACING_M2 = 1e-7  # smallest mean squared distance between seeds, m^2
_SAME_SURFACE = 0.05  # a Gaussian is visible if its mean is this close to the measured depth, as a share of its depth


class MonoGSMapper(DenseMapper):
    """Map with MonoGS; ``bounds`` is not used."""

    config: MonoGSConfig

    def __init__(self, config: MonoGSConfig, rng: np.random.Generator, bounds: np.ndarray | None = None) -> None:
        super().__init__(config, rng)
        self._window: list[int] = []  # indices of the keyframes in the window, newest first
        self._steps = 0  # number of optimiser steps taken
        self._reset_at = 0  # value of ``_steps`` when the moments were last set to 0
        self._ids_of_step: list[int] = []  # per step: `GaussianMap.next_id`, which shows the Gaussians inserted later

    def _seeds(self, frame: Frame) -> tuple[np.ndarray, float]:
        config = self.config
        rows, columns = np.nonzero(frame.depth > 0)
        count = round(len(rows) * (config.seed_share if self.keyframes else config.first_seed_share))
        if not count:
            return np.zeros((ROWS, 0), np.float32), 0.0
        chosen = np.sort(self._rng.choice(len(rows), count, replace=False))
        samples = pixel_samples(frame, rows[chosen], columns[chosen])
        points = transform_points(frame.world_from_camera, samples.points.astype(np.float64))
        sigma = seed_sigmas(points, float(np.median(frame.depth[frame.depth > 0])), config.point_size)
        return seed_balls(frame, samples, sigma, opacity=config.seed_opacity), count / frame.depth.size

    def _event(self, index: int, iterations: int) -> tuple[list[int], np.ndarray, int]:
        config = self.config
        self._renew_window(index)
        views: list[int] = []
        losses: list[tuple[float, float, float]] = []
        pruned = 0
        for _ in range(iterations * (config.first_rounds if index == 0 else 1)):
            if not self.map.count:
                break
            outside = np.setdiff1d(np.arange(index + 1), self._window)
            drawn = self._rng.permutation(outside)[: config.random_views].tolist()
            rows = leaf(self.map.parameters[:, : self.map.count])
            for view in (*self._window, *drawn):
                views.append(view)
                losses.append(self._add_loss(rows, view, self._loss))
            (config.roundness_weight * roundness(rows)).backward()  # type: ignore[no-untyped-call]
            self._ids_of_step.append(self.map.next_id)
            self._steps += 1
            rates = config.learning_rates()
            rates[MEAN] = mean_rate(config, self._steps)
            self._step(rows, slice(0, self.map.count), rates, self._steps - self._reset_at)
            if self._steps % config.prune_every == config.prune_after % config.prune_every:
                pruned += self._prune_opaque()
        return views, np.array(losses).reshape(-1, 3), pruned

    def refine(self, iterations: int, *, keyframe_indices: Sequence[int] | None = None) -> MappingReport:
        """Optimise all Gaussians on the colours of all or the given keyframes; then set the moments to 0."""
        report = super().refine(iterations, keyframe_indices=keyframe_indices)
        self.map.reset_moments()
        self._reset_at = self._steps
        return report

    def _loss(self, shown: Rasterization, rgb: torch.Tensor, depth: torch.Tensor) -> MappingLoss:
        return window_loss(shown, rgb, depth, self.config.color_share)

    def _renew_window(self, index: int) -> None:
        """Add keyframe ``index`` to the window, and remove keyframes with little overlap or beyond its size."""
        window = [index, *self._window]
        frames = self.keyframes
        means = self.map.parameters[MEAN, : self.map.count].T.astype(np.float64)
        own = seen_means(means, frames[index])
        foreign = [
            k for k in window[_NEWEST:] if overlap(own, seen_means(means, frames[k])) <= self.config.least_overlap
        ]
        if foreign:
            window.remove(foreign[-1])
        while len(window) > max(_NEWEST + 1, self.config.window):
            window.pop(crowded([frames[k].world_from_camera[:3, 3] for k in window]))
        self._window = window

    def _prune_opaque(self) -> int:
        """Remove Gaussians that are not opaque or too large. New Gaussians are not tested for ``prune_after`` steps."""
        config = self.config
        old = self._ids_of_step[-min(config.prune_after, len(self._ids_of_step))]
        tested = self.map.ids[: self.map.count] < old
        largest = self.map.parameters[LOG_SCALE, : self.map.count].max(axis=0)
        poor = self._transparent(config.prune_opacity) | ~(largest <= np.log(config.prune_size))
        return self.map.keep(~(tested & poor))


def seed_sigmas(points: np.ndarray, median_depth: float, point_size: float) -> np.ndarray:  # [n, 3] -> [n] metres
    """Return the standard deviations of the seeds of a keyframe: sqrt(d^2 p).

    d^2 is the mean squared distance of a point to its three nearest points, and p = min(0.05, point_size *
    median_depth) with the median depth of the image in metres.
    """
    squared = np.maximum(np.nan_to_num(spacing_squared(points, points)), _MIN_SPACING_M2)
    return np.sqrt(squared * min(0.05, point_size * median_depth))


def window_loss(shown: Rasterization, rgb: torch.Tensor, depth: torch.Tensor, color_share: float) -> MappingLoss:
    """Return the loss of one image: color_share mean |C - I| + (1 - color_share) mean |D - depth|.

    C and D are the rendered colour and accumulated depth, and I is ``rgb``. Means are over all pixels. Black pixels
    have no colour error, and pixels without a return no depth error.
    """
    lit, measured = (rgb.sum(dim=-1, keepdim=True) > _DARK), depth > _DARK
    by_color = ((shown.color - rgb) * lit).abs().mean()
    by_depth = ((shown.depth - depth) * measured).abs().mean()
    total = color_share * by_color + (1.0 - color_share) * by_depth
    return MappingLoss(total, torch.stack([by_color, by_depth, by_color.new_full((), torch.nan)]).detach())


def mean_rate(config: MonoGSConfig, step: int) -> float:
    """Return the learning rate of the means at a step. It decreases exponentially to ``config.mean_rate_end``."""
    share = min(1.0, step / config.mean_rate_steps)
    if config.mean_rate <= 0.0:
        return 0.0
    return float(config.mean_rate ** (1.0 - share) * config.mean_rate_end**share)


def seen_means(means: np.ndarray, frame: Frame) -> np.ndarray:  # [n, 3] -> [n] bool
    """Return the means [n, 3] that are in view of a keyframe and close to its measured depth."""
    camera = frame.camera
    points = transform_points(invert_rigid(frame.world_from_camera), means)
    z = points[:, 2]
    safe = np.where(z > 0, z, 1.0)
    u = np.floor(points[:, 0] / safe * camera.fx + camera.cx)
    v = np.floor(points[:, 1] / safe * camera.fy + camera.cy)
    inside = (z > 0) & (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    measured = np.zeros(len(means))
    measured[inside] = frame.depth[v[inside].astype(int), u[inside].astype(int)]
    return np.asarray((measured > 0) & (np.abs(z - measured) <= _SAME_SURFACE * z))


def overlap(a: np.ndarray, b: np.ndarray) -> float:  # [n] bool each
    """Return the overlap coefficient of two sets: size of intersection / size of the smaller set ([monogs, code])."""
    return int(np.count_nonzero(a & b)) / max(1, min(int(np.count_nonzero(a)), int(np.count_nonzero(b))))


def crowded(places: Sequence[np.ndarray]) -> int:
    """Return the index of the keyframe to remove from the window; ``places`` are its camera positions, newest first.

    The two newest are never removed. Of the others, the result maximises sqrt(distance to the newest) times the sum of
    1 / distance to the remaining ones ([monogs, code]).
    """
    rest = np.array(places[_NEWEST:])
    apart = np.linalg.norm(rest[:, None] - rest, axis=-1) + 1e-6
    np.fill_diagonal(apart, np.inf)
    away = np.sqrt(np.linalg.norm(rest - places[0], axis=1))
    return _NEWEST + int(np.argmax(away * (1.0 / apart).sum(axis=1)))
