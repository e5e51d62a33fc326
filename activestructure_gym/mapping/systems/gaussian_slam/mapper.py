"""Map with Gaussian-SLAM and given poses ([gaussian_slam, code]): the map is a sequence of sub-maps.

Only the newest sub-map is optimised. A new sub-map begins when the camera has moved or turned far enough. The Gaussians
of earlier sub-maps remain in the map unchanged, but are not rendered while the newest sub-map is seeded and optimised.

Differences from [gaussian_slam, code]:

- Poses are given.
- For a CPU, a sub-map begins with fewer pixels, and a mapping event has fewer iterations. Seed pixels are drawn by
  image gradient as there, but not from Canny edges.
- Rays go through pixel centres.
- Overlapping sub-maps are not thinned. The original thins them at the end of a run with cells of 2 cm, for more than a
  million Gaussians.
- `refine` optimises colours of degree 0.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree

from activestructure_gym.geometry import invert_rigid, transform_points
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping.gaussian_map import COLOR, MEAN, ROWS
from activestructure_gym.mapping.seeding import missing_pixels, pixel_samples, seed_balls
from activestructure_gym.mapping.systems.dense import DenseMapper, leaf, roundness, spacing_squared
from activestructure_gym.mapping.systems.gaussian_slam.config import GaussianSLAMConfig
from activestructure_gym.splatting.api import Rasterization
from activestructure_gym.splatting.torch_losses import MappingLoss, ssim


class GaussianSLAMMapper(DenseMapper):
    """Map with Gaussian-SLAM; ``bounds`` is not used."""

    config: GaussianSLAMConfig

    def __init__(self, config: GaussianSLAMConfig, rng: np.random.Generator, bounds: np.ndarray | None = None) -> None:
        super().__init__(config, rng)
        self._origin: np.ndarray | None = None  # [4, 4] world_from_camera: first pose of the newest sub-map
        self._start = 0  # first column of the newest sub-map in the arrays of the map
        self.submap_keyframes: list[int] = []  # indices of the keyframes of the newest sub-map, in order

    def _seeds(self, frame: Frame) -> tuple[np.ndarray, float]:
        config, pose = self.config, frame.world_from_camera
        begins = self._origin is None or exceeds(
            self._origin, pose, metres=config.submap_metres, degrees=config.submap_degrees
        )
        if begins:
            self._origin, self._start, self.submap_keyframes = np.array(pose), self.map.count, []
        missing = self._missing(frame)
        rows, columns = self._first_pixels(frame) if begins else np.nonzero(missing)
        behind = Frame(frame.rgb, frame.depth * np.float32(config.behind), pose, frame.camera)
        samples = pixel_samples(behind, rows, columns)
        points = transform_points(pose, samples.points.astype(np.float64))
        there = self.map.parameters[MEAN, self._start : self.map.count].T.astype(np.float64)
        if len(there) and len(points):
            free = cKDTree(there).query(points)[0] >= config.nearest_seed
            rows, columns, points = rows[free], columns[free], points[free]
            samples = pixel_samples(behind, rows, columns)
        share = float(np.count_nonzero(missing)) / missing.size
        if len(points) + len(there) < 2:
            return np.zeros((ROWS, 0), np.float32), share
        sigma = np.sqrt(np.maximum(spacing_squared(points, np.concatenate([there, points])), 1e-14))
        return seed_balls(behind, samples, sigma, opacity=config.seed_opacity), share

    def _missing(self, frame: Frame) -> np.ndarray:  # [H, W] bool
        """Return the pixels where the newest sub-map is transparent, or far behind the measured surface."""
        config, count = self.config, self.map.count - self._start
        if not count:
            return frame.depth > 0
        own = np.ascontiguousarray(self.map.parameters[:, self._start : self.map.count])
        shown = self.rasterizer.render(own, count, frame.camera, frame.world_from_camera)
        return missing_pixels(
            frame.depth,
            shown.depth,
            shown.alpha,
            covered_alpha=config.covered_alpha,
            error_factor=config.in_front_factor,
            error_floor=config.in_front_floor,
            normalised=False,
        )

    def _first_pixels(self, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
        """Return rows and columns of the seed pixels of a new sub-map, drawn uniformly and by image gradient."""
        config, size = self.config, frame.depth.size
        even = self._rng.choice(size, max(1, round(config.submap_seed_share * size)), replace=False)
        steep = gradient_size(frame.rgb).ravel()
        chosen = even
        if steep.sum() > 0:
            edges = self._rng.choice(size, round(config.submap_edge_share * size), p=steep / steep.sum())
            chosen = np.concatenate([even, edges])
        chosen = np.unique(chosen)
        chosen = chosen[frame.depth.ravel()[chosen] > 0]
        rows, columns = np.divmod(chosen, frame.camera.width)
        return rows, columns

    def _event(self, index: int, iterations: int) -> tuple[list[int], np.ndarray, int]:
        config, start = self.config, self._start
        if not self.submap_keyframes:
            iterations *= config.submap_rounds
        keyframes = [index, *self.submap_keyframes]
        self.submap_keyframes.append(index)
        share = view_shares(len(keyframes), config.current_share)
        views = [keyframes[k] for k in self._rng.choice(len(keyframes), iterations, p=share)]
        losses = np.full((iterations, 3), np.nan)
        self.map.first_moment[:, start : self.map.count] = 0.0
        self.map.second_moment[:, start : self.map.count] = 0.0
        half, pruned = iterations // 2, 0
        for step, view in enumerate(views):
            if step == half:
                pruned += self.map.keep(~self._transparent(config.prune_opacity, start))
            columns = slice(start, self.map.count)
            if columns.start == columns.stop:
                break
            rows = leaf(self.map.parameters[:, columns])
            losses[step] = self._add_loss(rows, view, self._loss)
            (config.roundness_weight * roundness(rows)).backward()  # type: ignore[no-untyped-call]
            rates, number = config.learning_rates(), np.full(ROWS, step + 1)
            number[COLOR] -= half
            if step < half:
                assert rows.grad is not None
                rows.grad[COLOR] = 0.0
                rates[COLOR], number[COLOR] = 0.0, 1
            self._step(rows, columns, rates, number)
        if iterations:
            pruned += self.map.keep(~self._transparent(config.prune_opacity, start))
        return views, losses, pruned

    def _loss(self, shown: Rasterization, rgb: torch.Tensor, depth: torch.Tensor) -> MappingLoss:
        config = self.config
        return submap_loss(
            shown, rgb, depth, image=config.image_weight, l1_share=config.l1_share, depth_weight=config.depth_weight
        )


def submap_loss(
    shown: Rasterization,
    rgb: torch.Tensor,  # [H, W, 3]
    depth: torch.Tensor,  # [H, W]
    *,
    image: float,
    l1_share: float,
    depth_weight: float,
) -> MappingLoss:
    """Return the loss of one image: w (s mean |C - I| + (1 - s) (1 - SSIM)) + v mean |D - depth|.

    C and D are the rendered colour and accumulated depth, and I is ``rgb``. The weights are w = ``image``, s =
    ``l1_share`` and v = ``depth_weight``. The two means are over pixels with a depth return; SSIM is over all pixels.
    """
    measured = depth > 0
    count = max(1, int(measured.sum()))
    by_color = (shown.color - rgb)[measured].abs().sum() / (3 * count)
    by_depth = (shown.depth - depth)[measured].abs().sum() / count
    alike = ssim(shown.color, rgb)
    total = image * (l1_share * by_color + (1.0 - l1_share) * (1.0 - alike)) + depth_weight * by_depth
    return MappingLoss(total, torch.stack([by_color, by_depth, alike]).detach())


def exceeds(origin: np.ndarray, pose: np.ndarray, *, metres: float, degrees: float) -> bool:  # [4, 4] each
    """Return whether ``pose`` is too far from the pose ``origin``, the first pose of a sub-map.

    It is if the distance exceeds ``metres`` or one of the three Euler angles of the relative rotation exceeds
    ``degrees``.
    """
    moved = invert_rigid(origin) @ pose
    turn = moved[:3, :3]
    level = float(np.hypot(turn[0, 0], turn[1, 0]))
    if level < 1e-6:
        angles = [np.arctan2(-turn[1, 2], turn[1, 1]), np.arctan2(-turn[2, 0], level), 0.0]
    else:
        angles = [
            np.arctan2(turn[2, 1], turn[2, 2]),
            np.arctan2(-turn[2, 0], level),
            np.arctan2(turn[1, 0], turn[0, 0]),
        ]
    return bool(np.linalg.norm(moved[:3, 3]) > metres or np.abs(np.degrees(angles)).max() > degrees)


def view_shares(keyframes: int, current: float) -> np.ndarray:  # [keyframes]
    """Return the probability that a step uses each keyframe of the sub-map; the current keyframe is the first.

    ``current`` is the probability of the current keyframe, and the others share the rest equally.
    """
    if keyframes == 1:
        return np.ones(1)
    shares = np.full(keyframes, (1.0 - current) / (keyframes - 1))
    shares[0] = current
    return shares / shares.sum()


def gradient_size(rgb: np.ndarray) -> np.ndarray:  # [H, W, 3] uint8 -> [H, W] float64
    """Return the magnitude of the brightness gradient at each pixel, from 3 x 3 Sobel filters."""
    import cv2

    grey = cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2GRAY)
    return np.hypot(cv2.Sobel(grey, cv2.CV_64F, 1, 0, ksize=3), cv2.Sobel(grey, cv2.CV_64F, 0, 1, ksize=3))
