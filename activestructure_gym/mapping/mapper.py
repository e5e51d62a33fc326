"""Map posed RGB-D frames: insert Gaussians where the map lacks surface, take a few optimiser steps, prune.

`MapperConfig` selects the recipe (default or SplaTAM's); measurements are in docs/notebook/lab_notes.md. The backend
`MapperConfig.backend` renders and optimises (`activestructure_gym.splatting.rasterizers`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from activestructure_gym.geometry.curve import curve_order
from activestructure_gym.geometry.frame import Frame, unit_rgb
from activestructure_gym.mapping.base import MappingReport
from activestructure_gym.mapping.config import MapperConfig
from activestructure_gym.mapping.density import (
    REDUNDANT,
    SEED,
    chunks_to_skip,
    measured_depth,
    states_of_samples,
    wanted_spacing,
)
from activestructure_gym.mapping.downsampling import reduced
from activestructure_gym.mapping.frustum_culling import MapParts
from activestructure_gym.mapping.gaussian_map import LOG_SCALE, MEAN
from activestructure_gym.mapping.keyframe_mapper import KeyframeMapper, checked_frame, report_of
from activestructure_gym.mapping.keyframes import draw_views
from activestructure_gym.mapping.local_planes import on_local_planes
from activestructure_gym.mapping.map_passes import CHUNK, too_wide, unfit
from activestructure_gym.mapping.seeding import grid_pixels, missing_pixels, pixel_samples, seed_balls, seed_disks
from activestructure_gym.mapping.surface_links import surface_links
from activestructure_gym.mapping.surface_samples import SurfaceSamples, samples_at, samples_between
from activestructure_gym.splatting import LossWeights

# A map with more Gaussians than the first number is sorted spatially, and again whenever it has grown by the second
# factor. Late keyframes insert few Gaussians in many places, so blocks in order of insertion would span rooms (measured
# in docs/notebook/map.md).
_ORDERED_ABOVE = 200_000
_ORDERED_AGAIN = 1.5


class Mapper(KeyframeMapper):
    """Map online from given poses. Equal configuration, generator and frames give equal parameters.

    The map grows with the observed surface (`activestructure_gym.mapping.density`) up to ``max_gaussians``. Beyond this
    limit, an even selection of the seeds is inserted, and coarse Gaussians are replaced only if all finer ones fit.

    Parameters
    ----------
    config : MapperConfig
        The recipe and its constants.
    rng : numpy.random.Generator
        Generator that draws keyframes and seeds.
    bounds : ndarray, optional
        Not used: the map is not limited to a box.
    """

    config: MapperConfig

    def __init__(self, config: MapperConfig, rng: np.random.Generator, bounds: np.ndarray | None = None) -> None:
        super().__init__(config, rng, border_share=config.overlap_border)
        self._ordered_above = _ORDERED_ABOVE  # number of Gaussians above which the map is sorted next
        self._largest_seed = 0.0  # largest sigma of a seed so far, metres
        self._largest_depth = 0.0  # largest depth of all frames, metres
        self._weights = LossWeights(
            image=config.image_weight,
            l1_share=config.l1_share,
            depth=config.depth_weight,
            alpha=config.alpha_weight,
            normalised_depth=config.normalised_depth,
            centre_depth=config.centre_depth,
        )

    @property
    def isotropic(self) -> bool:  # type: ignore[override]
        """Return whether every Gaussian is a ball with one scale."""
        return self.config.isotropic

    @property
    def scene_radius(self) -> float:
        """Return about half the size of the scene in metres. It is the reference for limits on lengths."""
        if self.config.scene_radius is not None:
            return self.config.scene_radius
        # The largest depth is over all frames, since the first frame can be close to a wall.
        return self._largest_depth / 3.0 if self._largest_depth > 0 else 2.0

    def observe(self, frame: Frame, *, iterations: int | None = None) -> MappingReport:
        """Add a keyframe, seed where the map lacks surface, and take ``iterations`` steps (None: as configured)."""
        frame = checked_frame(frame)
        iterations = self.config.iterations if iterations is None else iterations
        self.events += 1
        self._largest_depth = max(self._largest_depth, float(frame.depth.max()))
        boxes = MapParts(self.map, **self._slack(iterations), kept=True)
        unseen = boxes.unseen(frame.camera, frame.world_from_camera, self._hiding(frame))
        replaced, added, left_out, new_share = self._seed(frame, unseen)
        index = self._store.append(reduced(frame, self.config.keyframe_reduction), new_share=new_share)
        views: list[int] = []
        if iterations:  # selecting views takes as long as rendering one
            views = draw_views(iterations, self._local_views(index), self._global_views(index), self._rng)
        losses, pruned = self._optimize(views)
        # The new keyframe is measured, and then the keyframes with the oldest measurement.
        self._measure_psnr(self._store.stalest(1 + self.config.psnr_refresh))
        return report_of(
            self.map.count,
            views,
            losses,
            pruned,
            added=added,
            replaced=replaced,
            left_out=left_out,
            new_share=new_share,
            psnr=self._store.psnr[index],
        )

    def refine(self, iterations: int, *, keyframe_indices: Sequence[int] | None = None) -> MappingReport:
        """Optimise in ``iterations`` steps on all or the given keyframes, shuffled repeatedly, without seeding.

        Then prune. Only colours are optimised, unless ``config.refine_shapes``.
        """
        views = self._shuffled_views(iterations, keyframe_indices)
        self.events += 1
        losses, pruned = self._optimize(views, refining=True)
        return report_of(self.map.count, views, losses, pruned)

    def _seed(self, frame: Frame, unseen: np.ndarray | None) -> tuple[int, int, int, float]:
        """Insert Gaussians where the map lacks surface, and remove Gaussians that are coarser than the new ones.

        ``unseen`` marks chunks of the map outside the view of the frame. Returns the number removed, the number
        inserted, the number left out because of ``max_gaussians``, and the share of new pixels.
        """
        config, replaced = self.config, 0
        links: np.ndarray | None = None  # of the pixels of the frame
        if config.seed_spacing is None:
            seeds, sigma, new_share = self._seeds_by_rendering(frame, unseen)
        else:
            if config.depth_noise_scale:
                frame = replace(frame, depth=on_local_planes(frame.depth, config.depth_noise_scale))
            links = surface_links(frame.depth)
            spacing = wanted_spacing(
                frame,
                links,
                plain=config.seed_spacing,
                pixels=config.seed_pixels,
                contrast=config.texture_contrast,
            )
            coarse = self._coarse(frame, spacing, unseen)
            between = samples_between(frame, links, spacing)
            seeds, sigma, new_share = self._seeds_by_spacing(frame, between, spacing, unseen, coarse)
            leaving = np.flatnonzero(coarse)
            if len(leaving) and not self._room_for(len(sigma) - len(leaving)):
                # Without room for the finer Gaussians, removal would leave a gap.
                coarse[:], leaving = False, leaving[:0]
                seeds, sigma, new_share = self._seeds_by_spacing(frame, between, spacing, unseen, coarse)
            replaced = self.map.remove(leaving)
        count = len(sigma)
        room = count if config.max_gaussians is None else max(0, config.max_gaussians - self.map.count)
        if room < count:
            chosen = np.linspace(0, count, room, endpoint=False, dtype=int)
            seeds, sigma = SurfaceSamples(*(array[chosen] for array in seeds)), sigma[chosen]
        if len(sigma):
            self._largest_seed = max(self._largest_seed, float(sigma.max()))
            self.map.append(self._new_gaussians(frame, seeds, sigma, links))
        if self.map.count > self._ordered_above:
            self.map.reorder(curve_order(np.nan_to_num(self.map.means, posinf=0.0, neginf=0.0)))
            self._ordered_above = int(_ORDERED_AGAIN * self.map.count)
        return replaced, len(sigma), count - len(sigma), new_share

    def _hiding(self, frame: Frame) -> np.ndarray | None:  # [H, W] metres
        """Return the measured depth.

        Seeds of the default recipe are opaque at once and occlude all Gaussians behind it.
        """
        return None if self.config.seed_spacing is None else frame.depth

    def _psnr_of(self, shown: np.ndarray, frame: Frame) -> float:  # [H, W, 3], dB
        if self.config.psnr_of_returns:
            shown = np.where(frame.depth[..., None] > 0.0, shown, unit_rgb(frame))
        return super()._psnr_of(shown, frame)

    def _room_for(self, more: int) -> bool:
        """Return whether ``max_gaussians`` allows ``more`` additional Gaussians."""
        bound = self.config.max_gaussians
        return bound is None or self.map.count + more <= bound

    def _seeds_by_rendering(
        self, frame: Frame, unseen: np.ndarray | None
    ) -> tuple[SurfaceSamples, np.ndarray, float]:  # n seeds, their sigmas [n] in metres, share of new pixels
        """Return seeds on a pixel grid where the rendered map is transparent or too deep (SplaTAM's rule).

        ``unseen`` marks chunks of the map outside the view.
        """
        config, camera, pose = self.config, frame.camera, frame.world_from_camera
        if self.map.count:
            rendering = self.rasterizer.render(self.map.parameters, self.map.count, camera, pose, unseen=unseen)
            missing = missing_pixels(
                frame.depth,
                rendering.depth,
                rendering.alpha,
                covered_alpha=config.covered_alpha,
                error_factor=config.in_front_factor,
                error_floor=config.in_front_floor,
                normalised=config.normalised_depth,
            )
        else:
            missing = frame.depth > 0
        stride = max(1, round(camera.width / config.seed_columns))
        rows, columns = grid_pixels(missing, stride)
        footprint = config.seed_footprint * stride / (0.5 * (camera.fx + camera.fy))
        sigma = footprint * frame.depth[rows, columns]
        return pixel_samples(frame, rows, columns), sigma, float(np.count_nonzero(missing)) / missing.size

    def _seeds_by_spacing(
        self,
        frame: Frame,
        between: SurfaceSamples,
        spacing: np.ndarray,
        unseen: np.ndarray | None,
        leaving: np.ndarray,
    ) -> tuple[SurfaceSamples, np.ndarray, float]:  # n seeds, their sigmas [n] in metres, share of new pixels
        """Return seeds at the surface samples that have no mean within the wanted ``spacing`` [H, W] in metres.

        The samples are those at pixels and those ``between`` pixels. ``unseen`` marks chunks of the map outside the
        view, and ``leaving`` [count] marks Gaussians that will be removed.
        """
        states = states_of_samples(
            frame, between, spacing, self.map.parameters, self.map.count, unseen=unseen, leaving=leaving
        )
        wanted, size = np.flatnonzero(states == SEED), frame.depth.size
        pixels = np.searchsorted(wanted, size)
        parts = samples_at(frame, wanted[:pixels]), (array[wanted[pixels:] - size] for array in between)
        seeds = SurfaceSamples(*(np.concatenate(pair) for pair in zip(*parts)))
        new = np.count_nonzero((states[:size] == SEED) | (states[:size] == REDUNDANT))
        return seeds, self.config.seed_footprint * spacing.ravel()[seeds.pixels], float(new) / size

    def _new_gaussians(
        self, frame: Frame, seeds: SurfaceSamples, sigma: np.ndarray, links: np.ndarray | None
    ) -> np.ndarray:  # [14, n] float32
        config = self.config
        if config.isotropic or (config.seed_thickness == 1.0 and config.border_sigmas is None):
            return seed_balls(frame, seeds, sigma, opacity=config.seed_opacity)
        return seed_disks(
            frame,
            seeds,
            sigma,
            thickness=config.seed_thickness,
            opacity=config.seed_opacity,
            min_cosine=config.min_incidence_cosine,
            border_sigmas=config.border_sigmas,
            links=links,
        )

    def _coarse(self, frame: Frame, spacing: np.ndarray, unseen: np.ndarray | None) -> np.ndarray:  # [count] bool
        """Return a mask of the surface Gaussians in view that are wider than the seeds of this frame.

        ``spacing`` [H, W] is the wanted spacing in metres, and ``unseen`` marks chunks outside the view.
        """
        ratio, count = self.config.coarse_ratio, self.map.count
        if ratio is None or not count:
            return np.zeros(count, dtype=bool)
        largest = np.float32(ratio * self.config.seed_footprint) * spacing
        return too_wide(self.map.parameters, count, chunks_to_skip(unseen, count), measured_depth(frame), largest)

    def _local_views(self, index: int) -> list[int]:
        """Return the local keyframes: keyframe ``index``, the previous one, and others that overlap with ``index``."""
        local = [index] if index == 0 else [index, index - 1]
        overlapping = self._store.overlapping(
            index, self._rng, pixels=self.config.overlap_pixels, limit=self.config.window - 1
        )
        return (local + [k for k in overlapping if k not in local])[: self.config.window]

    def _global_views(self, index: int) -> list[int]:
        config = self.config
        poor = self._store.poor(psnr_threshold=config.global_psnr, new_share_threshold=config.global_new_share)
        return [k for k in poor if k != index]

    def _slack(self, iterations: int, *, refining: bool = False) -> dict[str, float]:
        """Return upper bounds of a Gaussian's displacement (metres) and growth (factor) in ``iterations`` steps."""
        config = self.config
        step = largest_adam_step(config.adam_beta1, config.adam_beta2)
        farthest = step * iterations * config.learning_rates(refining=refining)
        with np.errstate(over="ignore"):  # the bound is infinite for very many steps
            growth = float(np.exp(farthest[LOG_SCALE].max()))
        return {"shift": float(farthest[MEAN].max()), "growth": growth}

    def _optimize(self, views: Sequence[int], *, refining: bool = False) -> tuple[np.ndarray, int]:
        """Take one optimiser step on the keyframe of each entry of ``views``, and prune.

        Returns the losses of every step ([steps, 3]: colour, depth, ssim) and the number of Gaussians pruned.
        """
        config = self.config
        losses = np.full((len(views), 3), np.nan)
        self._before_steps()
        if config.adam_reset:
            self.map.reset_moments()
        own_rates, epsilon = config.learning_rates(refining=refining), config.adam_epsilon
        rates = own_rates
        pruned = 0
        # Chunks changed since the last pruning; at first all may have changed.
        changed = np.ones(-(-self.map.count // CHUNK), dtype=bool)
        starts = [step for step in range(len(views)) if step == 0 or step in config.prune_steps]
        for start, stop in pairwise([*starts, len(views)]):
            if start in config.prune_steps:
                pruned += self._prune(changed)
            if not self.map.count:
                break
            # Boxes that remain valid for all remaining steps.
            parts = MapParts(self.map, **self._slack(len(views), refining=refining), kept=True)
            changed = np.zeros(-(-self.map.count // CHUNK), dtype=bool)
            steps = self.rasterizer.begin(
                self.map.parameters,
                self.map.first_moment,
                self.map.second_moment,
                self.map.count,
                weights=self._weights,
                beta1=config.adam_beta1,
                beta2=config.adam_beta2,
                isotropic=config.isotropic,
            )
            for step in range(start, stop):
                if config.adam_reset:
                    # Adam's bias correction is applied to learning rate and epsilon, since the kernel has none.
                    root = np.sqrt(1.0 - config.adam_beta2 ** (step + 1))
                    rates = own_rates * (root / (1.0 - config.adam_beta1 ** (step + 1)))
                    epsilon = config.adam_epsilon * root
                frame = self._store.frames[views[step]]
                unseen = parts.unseen(frame.camera, frame.world_from_camera, self._hiding(frame))
                stepped = np.ones_like(changed) if unseen is None else ~unseen
                changed |= stepped
                self.map.touched(stepped)
                steps.step(frame, learning_rates=rates, epsilon=epsilon, unseen=unseen)
            losses[start:stop] = steps.end()
        if -1 in config.prune_steps:
            pruned += self._prune(changed)
        self._after_steps()
        return losses, pruned

    def _prune(self, changed: np.ndarray) -> int:
        """Remove Gaussians that are transparent, too large or not finite; return their number.

        Only ``changed`` chunks ([chunks] bool) are tested: the others passed the last test, and the size limit only
        rises.
        """
        threshold = self.config.prune_opacity
        # At a coarse resolution, seeds can exceed the size limit; they must not be removed.
        limit = max(self.config.prune_scale * self.scene_radius, 2.0 * self._largest_seed)
        with np.errstate(divide="ignore"):  # the thresholds 0 and 1 give infinite logits
            least_logit = float(np.log(threshold) - np.log1p(-threshold))
        return self.map.remove(unfit(self.map.parameters, self.map.count, least_logit, float(np.log(limit)), changed))


def largest_adam_step(beta1: float, beta2: float) -> float:
    """Return an upper bound of the length of an Adam step without bias correction, in units of the learning rate.

    b1 and b2 are the decay rates ``beta1`` and ``beta2``. The bound is (1 - b1) / sqrt((1 - b2) (1 - b1^2 / b2)), by
    the Cauchy-Schwarz inequality over all past gradients. It is infinite if b1^2 >= b2.
    """
    rest = 1.0 - beta1**2 / beta2
    return (1.0 - beta1) / np.sqrt((1.0 - beta2) * rest) if rest > 0 else np.inf
