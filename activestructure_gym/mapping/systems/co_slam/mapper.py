"""Map with Co-SLAM and given poses ([co_slam, code]): a neural field of distance and colour.

The field gives the signed distance to the surface and the colour of a point. It is trained on rays of keyframes. `map`
is the surface as disks, where keyframes observed it. The disks are extracted at the sign changes of the distance along
the edges of a grid, as the vertices of a marching-cubes mesh would be. Protocols evaluate this map, including its
images. These are worse than the images of `render`, which integrates the field along rays.

Differences from [co_slam]:

- Poses are given.
- The field is smaller: 8 levels down to 5 cm with 2^15 entries, instead of 16 levels down to 2 cm with 2^16.
- There are fewer rays, and a larger share of a keyframe's pixels is stored, for a CPU and small images.
- Samples along a ray cover the whole box.
- There is no smoothness term (weight 1e-6 there).
- The one-blob encoding uses Gaussians instead of a polynomial approximation.
- The surface is extracted from a coarser grid.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame, unit_rgb
from activestructure_gym.mapping.base import MappingReport
from activestructure_gym.mapping.downsampling import reduced
from activestructure_gym.mapping.gaussian_map import GaussianMap
from activestructure_gym.mapping.keyframe_mapper import KeyframeMapper, checked_frame, psnr, report_of
from activestructure_gym.mapping.systems.co_slam.config import CoSLAMConfig
from activestructure_gym.mapping.systems.co_slam.joint_encoding import JointField, distance_losses, ray_weights
from activestructure_gym.mapping.systems.co_slam.zero_level import VertexGrid, disks
from activestructure_gym.mapping.systems.dense import one_thread
from activestructure_gym.splatting import Rendering

_AT_ONCE = 1 << 17  # points per evaluation of the field, which limits the memory
_RENDER_STEP = 0.05  # metres between two samples of a ray when an image is rendered
_PSNR_STRIDE = 4  # pixels: every fourth row and column is used to measure the PSNR of a keyframe


class Rays(NamedTuple):
    """Hold r rays through pixels of keyframes; a ray's parameter is its depth."""

    keyframe: np.ndarray  # [r] int, index of the keyframe
    directions: np.ndarray  # [r, 3] float32, world; scaled to z = 1 in the camera frame
    colors: np.ndarray  # [r, 3] float32 0..1
    depths: np.ndarray  # [r] float32 metres, 0 = no return

    def some(self, index: np.ndarray) -> Rays:
        """Return the rays at the indices ``index`` [n]."""
        return Rays(*(array[index] for array in self))


class CoSLAMMapper(KeyframeMapper):
    """Map with Co-SLAM; ``bounds`` [2, 3] is the box of the field in metres."""

    config: CoSLAMConfig

    def __init__(self, config: CoSLAMConfig, rng: np.random.Generator, bounds: np.ndarray) -> None:
        self._gaussians = GaussianMap()
        self._mapped = 0  # number of the event after which the disks were extracted
        super().__init__(config, rng)
        self._low = torch.tensor(np.asarray(bounds[0]), dtype=torch.float32)
        self._extent = torch.tensor(np.asarray(bounds[1]) - np.asarray(bounds[0]), dtype=torch.float32)
        finest = max(config.coarsest, round(float(self._extent.max()) / config.finest_m))
        generator = torch.Generator().manual_seed(int(rng.integers(2**62)))
        self.field = JointField(config.levels, config.coarsest, finest, config.log2_entries, generator)
        decoders = [*self.field.distance.parameters(), *self.field.color.parameters()]
        self._adam = torch.optim.Adam(
            [
                {"params": decoders, "lr": config.decoder_rate, "weight_decay": 1e-6},
                {"params": list(self.field.grid.parameters()), "lr": config.grid_rate, "eps": 1e-15},
            ],
            betas=(0.9, 0.99),
        )
        self._vertices = VertexGrid(np.asarray(bounds, dtype=np.float64), config.surface_m)
        self._rays: list[Rays] = []  # one entry per keyframe: its stored rays

    @property
    def map(self) -> GaussianMap:
        """Return the surface of the field as disks. They are extracted again after every mapping event."""
        if self._mapped != self.events:
            self._gaussians.keep(np.zeros(self._gaussians.count, dtype=bool))
            self._gaussians.append(self._surface())
            self._mapped = self.events
        return self._gaussians

    @map.setter
    def map(self, gaussians: GaussianMap) -> None:
        self._gaussians = gaussians

    def observe(self, frame: Frame, *, iterations: int | None = None) -> MappingReport:
        """Add a keyframe, store some of its rays, and train the field in ``iterations`` steps (None: as configured)."""
        frame = checked_frame(frame)
        config = self.config
        iterations = config.iterations if iterations is None else iterations
        self.events += 1
        # Here the new share is the share of newly observed grid vertices, not of pixels.
        before = int(np.count_nonzero(self._vertices.seen))
        self._vertices.observe(frame, config.truncation)
        after = int(np.count_nonzero(self._vertices.seen))
        index = self._store.append(
            reduced(frame, config.keyframe_reduction), new_share=(after - before) / max(1, after)
        )
        stored = self.keyframes[index]
        all_rays = rays_of(stored, index)
        kept = self._rng.choice(
            len(all_rays.depths), max(1, round(config.ray_share * len(all_rays.depths))), replace=False
        )
        self._rays.append(all_rays.some(np.sort(kept)))
        with one_thread():
            losses = self._learn(all_rays, iterations * (config.first_rounds if index == 0 else 1))
            self._measure_psnr(self._store.stalest(1))
        return report_of(
            self._gaussians.count,  # number at the last extraction
            [index] * len(losses),
            losses,
            0,
            new_share=self._store.new_share[index],
            psnr=self._store.psnr[index],
        )

    def refine(self, iterations: int, *, keyframe_indices: Sequence[int] | None = None) -> MappingReport:
        """Train the field in ``iterations`` steps on the stored rays of all or the given keyframes."""
        indices = sorted(set(self._shuffled_views(len(self.keyframes), keyframe_indices)))
        self.events += 1
        with one_thread():
            losses = self._learn(None, iterations, indices) if indices else np.zeros((0, 3))
        return report_of(self._gaussians.count, indices[:iterations], losses, 0)

    def render(self, camera: PinholeCamera, world_from_camera: np.ndarray) -> Rendering:
        """Render colour, depth and alpha by integrating the field along rays.

        Alpha is 1 where a ray meets the surface, else 0.
        """
        directions = (camera.rays().reshape(-1, 3) @ world_from_camera[:3, :3].T).astype(np.float32)
        with one_thread():
            color, depth, met = self._integrated(world_from_camera[:3, 3], directions)
        shape = (camera.height, camera.width)
        alpha = met.astype(np.float32).reshape(shape)
        return Rendering(color.reshape(*shape, 3) * alpha[..., None], depth.reshape(shape) * alpha, alpha)

    @property
    def persistent_map(self) -> GaussianMap:
        """Raise `InputError`: no Gaussian of this mapper exists for more than one event."""
        raise InputError(
            "mapper co_slam creates new Gaussians in every event, but a feature of this planner needs persistent ones: "
            "choose another mapper or planner"
        )

    def _learn(
        self, newest: Rays | None, steps: int, keyframes: Sequence[int] | None = None
    ) -> np.ndarray:  # [steps, 3] losses: colour, depth in metres, nan
        """Train the field in ``steps`` steps, and return the losses of each.

        A step uses stored rays of the ``keyframes`` (None: all), and rays from all pixels of the ``newest`` keyframe,
        if given.
        """
        config = self.config
        chosen = self._rays if keyframes is None else [self._rays[k] for k in keyframes]
        kept = Rays(*(np.concatenate(arrays) for arrays in zip(*chosen)))
        losses = np.full((steps, 3), np.nan)
        for step in range(steps):
            rays = kept.some(self._rng.integers(len(kept.depths), size=config.rays))
            if newest is not None:
                count = max(config.rays // len(self._rays), config.least_newest)
                own = newest.some(self._rng.integers(len(newest.depths), size=count))
                rays = Rays(*(np.concatenate(pair) for pair in zip(rays, own)))
            total, color, depth = self._loss(rays)
            self._adam.zero_grad()
            total.backward()  # type: ignore[no-untyped-call]
            self._adam.step()
            losses[step, :2] = color, depth
        return losses

    def _loss(self, rays: Rays) -> tuple[torch.Tensor, float, float]:
        """Return the total loss of the rays, and their mean absolute errors of colour and depth (metres)."""
        config, truncation = self.config, self.config.truncation
        measured = torch.from_numpy(rays.depths)
        depths = torch.from_numpy(self._sampled(rays.depths))
        eyes = np.array([frame.world_from_camera[:3, 3] for frame in self.keyframes], np.float32)[rays.keyframe]
        points = torch.from_numpy(eyes)[:, None] + depths[..., None] * torch.from_numpy(rays.directions)[:, None]
        distances, colors = self._ask(points.reshape(-1, 3))
        distances = distances.reshape(depths.shape)
        weights = ray_weights(distances, depths, truncation)
        shown = (weights[..., None] * colors.reshape(*depths.shape, 3)).sum(dim=1)
        depth = (weights * depths).sum(dim=1)
        returned = measured > 0
        color_off, depth_off = shown - torch.from_numpy(rays.colors), (depth - measured)[returned]
        of_ray = torch.where(returned, 1.0, config.color_without_depth)[:, None]
        by_surface, by_free = distance_losses(distances, depths, measured, truncation)
        total = (
            config.color_weight * ((color_off * of_ray) ** 2).mean()
            + config.ray_depth_weight * (depth_off**2).sum() / max(1, len(depth_off))
            + config.surface_weight * by_surface
            + config.free_weight * by_free
        )
        error = float(depth_off.detach().abs().sum()) / max(1, len(depth_off))
        return total, float(color_off.detach().abs().mean()), error

    def _sampled(self, measured: np.ndarray) -> np.ndarray:  # [r] -> [r, s] float32 metres, rising
        """Return the depths of s samples along each ray, for measured depths [r] in metres.

        Some samples are distributed evenly over the box, others around the measured depth. Each is moved at random by
        up to half the distance to its neighbours.
        """
        config, farthest = self.config, self._farthest
        even = np.broadcast_to(np.linspace(0.0, farthest, config.even_samples), (len(measured), config.even_samples))
        around = measured[:, None] + np.linspace(-config.truncation, config.truncation, config.near_samples)
        around[measured <= 0] = np.linspace(0.0, farthest, config.near_samples)
        depths = np.sort(np.concatenate([even, around], axis=1), axis=1)
        middle = 0.5 * (depths[:, 1:] + depths[:, :-1])
        low = np.concatenate([depths[:, :1], middle], axis=1)
        high = np.concatenate([middle, depths[:, -1:]], axis=1)
        return (low + (high - low) * self._rng.random(depths.shape)).astype(np.float32)

    @property
    def _farthest(self) -> float:
        """Return the length of the box's diagonal in metres, the largest depth of a sample."""
        return float(torch.linalg.norm(self._extent))

    def _ask(self, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:  # [n, 3] metres -> [n], [n, 3]
        found: tuple[torch.Tensor, torch.Tensor] = self.field((points - self._low) / self._extent)
        return found

    def _integrated(
        self, eye: np.ndarray, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # colour [r, 3], depth [r] metres, surface met [r] bool
        depths = torch.arange(0.0, self._farthest, _RENDER_STEP)
        at_once = max(1, _AT_ONCE // len(depths))
        parts = []
        with torch.no_grad():
            start = torch.tensor(np.asarray(eye), dtype=torch.float32)
            for first in range(0, len(directions), at_once):
                some = torch.from_numpy(directions[first : first + at_once])
                points = start + depths[:, None] * some[:, None]
                distances, colors = self._ask(points.reshape(-1, 3))
                distances, along = distances.reshape(len(some), -1), depths.expand(len(some), -1)
                weights = ray_weights(distances, along, self.config.truncation)
                met = (distances[:, 1:] * distances[:, :-1] < 0.0).any(dim=1)
                color = (weights[..., None] * colors.reshape(*distances.shape, 3)).sum(dim=1)
                parts.append((color.numpy(), (weights * along).sum(dim=1).numpy(), met.numpy()))
        found = [np.concatenate(arrays) for arrays in zip(*parts)]
        return found[0], found[1], found[2]

    def _surface(self) -> np.ndarray:  # [14, n]
        """Return the surface of the field as disks, the columns of a map."""
        config, vertices = self.config, self._vertices
        values = np.ones(vertices.shape, dtype=np.float32)
        seen = np.flatnonzero(vertices.seen)
        with one_thread():
            values.reshape(-1)[seen] = self._values(vertices.points(seen))[0]
            crossings = vertices.crossings(values)
            colors = self._values(crossings.points)[1]
        bound = config.max_gaussians
        if bound is not None and len(colors) > bound:
            chosen = np.linspace(0, len(colors), bound, endpoint=False, dtype=int)
            crossings, colors = type(crossings)(*(array[chosen] for array in crossings)), colors[chosen]
        sigma = config.disk_share * config.surface_m
        return disks(crossings, colors, sigma, thickness=config.disk_thickness, opacity=config.disk_opacity)

    def _values(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # [n, 3] metres -> [n], [n, 3]
        """Return distances (in units of the truncation) and colours of points, without gradients."""
        distances, colors = np.empty(len(points), np.float32), np.empty((len(points), 3), np.float32)
        with torch.no_grad():
            for first in range(0, len(points), _AT_ONCE):
                some = slice(first, first + _AT_ONCE)
                found = self._ask(torch.tensor(points[some], dtype=torch.float32))
                distances[some], colors[some] = found[0].numpy(), found[1].numpy()
        return distances, colors

    def _measure_psnr(self, indices: Sequence[int]) -> None:
        for index in indices:
            frame = self.keyframes[index]
            down, right = (slice(min(_PSNR_STRIDE // 2, size - 1), None, _PSNR_STRIDE) for size in frame.depth.shape)
            rays = frame.camera.rays()[down, right].reshape(-1, 3)
            true = unit_rgb(frame)[down, right].reshape(-1, 3)
            directions = (rays @ frame.world_from_camera[:3, :3].T).astype(np.float32)
            color, _, met = self._integrated(frame.world_from_camera[:3, 3], directions)
            self._store.record_psnr(index, psnr(color * met[:, None], true))


def rays_of(frame: Frame, index: int) -> Rays:
    """Return all pixels of the keyframe with index ``index`` as rays."""
    directions = frame.camera.rays().reshape(-1, 3) @ frame.world_from_camera[:3, :3].T
    return Rays(
        np.full(len(directions), index),
        directions.astype(np.float32),
        unit_rgb(frame).reshape(-1, 3),
        frame.depth.reshape(-1).astype(np.float32),
    )
