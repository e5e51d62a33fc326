"""MonoGS with depth, as a mapper on given poses ([monogs, code]): a window of keyframes, rendered whole in every step.

Every keyframe brings points, wherever the map stands already; what does not become opaque is pruned. What differs:
no poses and no exposure are learnt; when a keyframe comes is the agent's matter; nothing is cloned or split, and
opacities are not reset (there at every 2001st step); what two keyframes share is told by the means at their measured
depth, not by the pixels that Gaussians were blended in; Gaussians are not judged by their radius in pixels, and only
after as many steps as its 150 per keyframe give them before the first judgement, since here steps are few.
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

_NEWEST = 2  # keyframes that stay in the window whatever they share
_DARK = 0.01  # sum of the three colours up to which a pixel is not compared; metres of depth, as well
_MIN_SPACING_M2 = 1e-7  # m^2
_SAME_SURFACE = 0.05  # of the depth: how far a mean may stand from what a keyframe measured there and count as seen


class MonoGSMapper(DenseMapper):
    """See the module; `MonoGSConfig` has the constants."""

    config: MonoGSConfig

    def __init__(self, config: MonoGSConfig, rng: np.random.Generator, bounds: np.ndarray | None = None) -> None:
        super().__init__(config, rng)
        self._window: list[int] = []  # keyframes, newest first
        self._steps = 0
        self._reset_at = 0  # of these, when the moments were 0 last
        self._ids_of_step: list[int] = []  # ids there were when each step was taken

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
                losses.append(self._look(rows, view, self._loss))
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
        """Optimise the whole map over all keyframes (or the given ones) by their colours; the moments begin anew."""
        report = super().refine(iterations, keyframe_indices=keyframe_indices)
        self.map.reset_moments()
        self._reset_at = self._steps
        return report

    def _loss(self, shown: Rasterization, rgb: torch.Tensor, depth: torch.Tensor) -> MappingLoss:
        return window_loss(shown, rgb, depth, self.config.color_share)

    def _renew_window(self, index: int) -> None:
        """Put the newest keyframe into the window, and take out what the rules say."""
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
        """Remove Gaussians that have had their steps and are not opaque, or are large."""
        config = self.config
        old = self._ids_of_step[-min(config.prune_after, len(self._ids_of_step))]
        judged = self.map.ids[: self.map.count] < old
        largest = self.map.parameters[LOG_SCALE, : self.map.count].max(axis=0)
        poor = self._transparent(config.prune_opacity) | ~(largest <= np.log(config.prune_size))
        return self.map.keep(~(judged & poor))


def seed_sigmas(points: np.ndarray, median_depth: float, point_size: float) -> np.ndarray:  # [n, 3] -> [n] metres
    """Size of the points of one keyframe: sqrt(d^2 p), d^2 the mean squared distance to the next three, p metres."""
    squared = np.maximum(np.nan_to_num(spacing_squared(points, points)), _MIN_SPACING_M2)
    return np.sqrt(squared * min(0.05, point_size * median_depth))


def window_loss(shown: Rasterization, rgb: torch.Tensor, depth: torch.Tensor, color_share: float) -> MappingLoss:
    """share * mean |C - I| + (1 - share) * mean |D - depth|, depth as accumulated; means over all pixels.

    Pixels that are black, or without a return, count as equal.
    """
    lit, measured = (rgb.sum(dim=-1, keepdim=True) > _DARK), depth > _DARK
    by_color = ((shown.color - rgb) * lit).abs().mean()
    by_depth = ((shown.depth - depth) * measured).abs().mean()
    total = color_share * by_color + (1.0 - color_share) * by_depth
    return MappingLoss(total, float(by_color.detach()), float(by_depth.detach()), float("nan"))


def mean_rate(config: MonoGSConfig, step: int) -> float:
    """The rate of the means, which falls exponentially from one constant to the other."""
    share = min(1.0, step / config.mean_rate_steps)
    if config.mean_rate <= 0.0:
        return 0.0
    return float(config.mean_rate ** (1.0 - share) * config.mean_rate_end**share)


def seen_means(means: np.ndarray, frame: Frame) -> np.ndarray:  # [n, 3] -> [n] bool
    """Means in the picture of a keyframe that stand about where it measured a surface."""
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
    """The overlap coefficient: what both see, of what that one sees which sees less ([monogs, code])."""
    return int(np.count_nonzero(a & b)) / max(1, min(int(np.count_nonzero(a)), int(np.count_nonzero(b))))


def crowded(places: Sequence[np.ndarray]) -> int:
    """Which keyframe of the window, newest first, goes: far from the newest one and near the others that may go.

    The greatest sqrt(distance to the newest) * sum of 1 / distance to the others ([monogs, code]).
    """
    rest = np.array(places[_NEWEST:])
    apart = np.linalg.norm(rest[:, None] - rest, axis=-1) + 1e-6
    np.fill_diagonal(apart, np.inf)
    away = np.sqrt(np.linalg.norm(rest - places[0], axis=1))
    return _NEWEST + int(np.argmax(away * (1.0 / apart).sum(axis=1)))
