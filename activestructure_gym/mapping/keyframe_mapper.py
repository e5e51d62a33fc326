"""Define the common part of all mappers of this package: a map of Gaussians with stored keyframes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Hashable, Sequence
from dataclasses import replace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame, unit_rgb, warn_of_millimetres
from activestructure_gym.mapping.base import BaseMapperConfig, MappingReport
from activestructure_gym.mapping.frustum_culling import MapParts
from activestructure_gym.mapping.gaussian_map import GaussianMap
from activestructure_gym.mapping.keyframes import KeyframeStore
from activestructure_gym.splatting import Rendering
from activestructure_gym.splatting.rasterizers import Rasterizer, rasterizer

# Keyframes rendered per decision to find the ones with the lowest PSNR. Their pixels are an eighth of the pixels of 256
# candidates at half the size (own choice, docs/notebook/performance.md).
PSNR_RENDERS = 8


@runtime_checkable
class StepFollower(Protocol):
    """Define the methods that are called around the optimiser steps of a mapping event.

    They are called on the objects in `KeyframeMapper.memory` that have them.
    """

    def before_steps(self) -> None:
        """Run before the steps of an event, after the seeds were inserted."""

    def after_steps(self) -> None:
        """Run after the steps of an event. Steps can remove Gaussians but not add any."""


class KeyframeMapper(ABC):
    """Hold the Gaussians and the keyframes of a map. Subclasses define `observe` and `refine`.

    Parameters
    ----------
    config : BaseMapperConfig
        The configuration of the mapper.
    rng : numpy.random.Generator
        Generator that draws keyframes and seeds.
    border_share : float
        Share of the image width at each border that is ignored when keyframes are tested for overlap.

    Raises
    ------
    InputError
        The backend cannot run on this machine.
    """

    map: GaussianMap
    isotropic = False  # whether every Gaussian is a ball with one scale

    def __init__(self, config: BaseMapperConfig, rng: np.random.Generator, *, border_share: float = 0.0) -> None:
        rasterizer(config.backend)  # raises InputError if the backend cannot run here
        self.config = config
        self.map = GaussianMap()
        self._rng = rng
        self._store = KeyframeStore(border_share=border_share)
        self.events = 0  # number of mapping events: new keyframes and refinements
        self.memory: dict[Hashable, Any] = {}  # state that features keep over an episode, see `FeatureContext.episode`

    @abstractmethod
    def observe(self, frame: Frame, *, iterations: int | None = None) -> MappingReport:
        """Add a keyframe and optimise the map in ``iterations`` steps (None: as configured)."""

    @abstractmethod
    def refine(self, iterations: int, *, keyframe_indices: Sequence[int] | None = None) -> MappingReport:
        """Optimise the map in ``iterations`` steps on all or the given keyframes, without adding one."""

    @property
    def rasterizer(self) -> Rasterizer:
        """Return the rasteriser that renders and optimises the map."""
        return rasterizer(self.config.backend)

    @property
    def persistent_map(self) -> GaussianMap:
        """Return the map for features that identify Gaussians by id over several events."""
        return self.map

    @property
    def keyframes(self) -> list[Frame]:
        """Return all observed frames in order, with their resolution divided by ``config.keyframe_reduction``."""
        return self._store.frames

    def render(self, camera: PinholeCamera, world_from_camera: np.ndarray) -> Rendering:
        """Render colour [H, W, 3], accumulated depth [H, W] in metres and alpha [H, W] from a pose."""
        unseen = MapParts(self.map, kept=True).unseen(camera, world_from_camera)
        return self.rasterizer.render(self.map.parameters, self.map.count, camera, world_from_camera, unseen=unseen)

    def render_depth_alpha(
        self,
        camera: PinholeCamera,
        world_from_camera: np.ndarray,  # [C, 4, 4] poses
    ) -> tuple[np.ndarray, np.ndarray]:  # accumulated depth [C, H, W] metres, alpha [C, H, W]
        """Render depth and alpha from many poses, for scoring candidate views."""
        if not self.map.count:
            empty = np.zeros((2, len(world_from_camera), camera.height, camera.width), np.float32)
            return empty[0], empty[1]
        parameters, count = MapParts(self.map, kept=True).in_view(camera, world_from_camera)
        return self.rasterizer.render_depth_alpha(parameters, count, camera, world_from_camera)

    def keyframe_psnr(self, *, renders: int | None = PSNR_RENDERS) -> np.ndarray:  # [T] float64 dB
        """Return the PSNR of every keyframe.

        It is measured again for ``renders`` keyframes, and is the last value for others. A quarter of the rendered
        keyframes have the oldest values, the others the lowest. So no value is older than ``ceil(T / ceil(renders /
        4))`` calls, and the cost does not grow with the number of keyframes. With ``renders=None`` all keyframes are
        measured.
        """
        count = len(self.keyframes) if renders is None else renders
        if count:
            self._measure_psnr(self._store.to_measure(oldest=-(-count // 4), count=count))
        return np.array(self._store.psnr, dtype=np.float64)

    def _shuffled_views(self, iterations: int, keyframe_indices: Sequence[int] | None) -> list[int]:
        """Return ``iterations`` keyframe indices, by repeated shuffling of ``keyframe_indices`` (None: all)."""
        indices = np.arange(len(self.keyframes)) if keyframe_indices is None else np.asarray(keyframe_indices, int)
        if len(indices) and not (0 <= indices.min() and indices.max() < len(self.keyframes)):
            raise ValueError(f"keyframe indices must lie in 0..{len(self.keyframes) - 1}, got {indices.tolist()}")
        views: list[int] = []
        while len(indices) and len(views) < iterations:
            views += self._rng.permutation(indices).tolist()
        return views[:iterations]

    def _before_steps(self) -> None:
        """Call ``before_steps`` of the objects in `memory`: the seeds of an event are inserted and its steps begin."""
        for kept in self.memory.values():
            if isinstance(kept, StepFollower):
                kept.before_steps()

    def _after_steps(self) -> None:
        """Call ``after_steps`` of the objects in `memory`: the steps and the pruning of an event are done."""
        for kept in self.memory.values():
            if isinstance(kept, StepFollower):
                kept.after_steps()

    def _hiding(self, frame: Frame) -> np.ndarray | None:  # [H, W] metres
        """Return the depth beyond which Gaussians do not affect the image of a keyframe; None if it is unknown."""
        return None

    def _measure_psnr(self, indices: Sequence[int]) -> None:
        parts = MapParts(self.map, kept=True) if len(indices) else None
        for index in indices:
            frame = self._store.frames[index]
            camera, pose = frame.camera, frame.world_from_camera
            unseen = parts.unseen(camera, pose, self._hiding(frame)) if parts else None
            shown = self.rasterizer.render(self.map.parameters, self.map.count, camera, pose, unseen=unseen).color
            self._store.record_psnr(index, self._psnr_of(shown, frame))

    def _psnr_of(self, shown: np.ndarray, frame: Frame) -> float:  # [H, W, 3], dB
        """Return the PSNR of a keyframe from its rendered colours."""
        return psnr(np.clip(shown, 0.0, 1.0), unit_rgb(frame))


def checked_frame(frame: Frame) -> Frame:
    """Return the frame with all depths that are not finite set to 0 (no return).

    Issues an `InputWarning` for depth in millimetres. Raises `ValueError` if the sizes of image and camera differ, if
    colours are not uint8 or depth is not in floats (metres), or if the pose is not [4, 4] finite numbers.
    """
    if frame.rgb.dtype != np.uint8 or frame.depth.dtype.kind != "f":
        raise ValueError(
            f"a frame has rgb in uint8 and depth in metres as floats, got {frame.rgb.dtype} and {frame.depth.dtype}"
        )
    pose = np.asarray(frame.world_from_camera)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise ValueError(f"a pose is an array [4, 4] of finite numbers, got {pose.tolist()}")
    shape = (frame.camera.height, frame.camera.width)
    if frame.depth.shape != shape or frame.rgb.shape != (*shape, 3):
        raise ValueError(
            f"the frame's camera has {shape} pixels, but rgb is {frame.rgb.shape} and depth {frame.depth.shape}"
        )
    warn_of_millimetres(frame.depth, stacklevel=3)
    known = np.isfinite(frame.depth)
    return frame if known.all() else replace(frame, depth=np.where(known, frame.depth, np.float32(0.0)))


def report_of(
    count: int,
    views: list[int],
    losses: np.ndarray,
    pruned: int,
    *,
    added: int = 0,
    replaced: int = 0,
    left_out: int = 0,
    new_share: float = 0.0,
    psnr: float = float("nan"),
) -> MappingReport:
    """Return the report of an event; ``losses`` [steps, 3] holds colour, depth and ssim of each step.

    ``count`` is the number of Gaussians after the event; the other arguments are those of `MappingReport`.
    """
    means = losses.mean(axis=0) if len(losses) else np.full(3, np.nan)
    return MappingReport(
        added=added,
        replaced=replaced,
        pruned=pruned,
        left_out=left_out,
        count=count,
        new_share=new_share,
        views=tuple(views),
        color_loss=float(means[0]),
        depth_loss=float(means[1]),
        ssim=float(means[2]),
        psnr=psnr,
    )


def psnr(shown: np.ndarray, true: np.ndarray) -> float:  # any equal shapes, 0..1
    """Return the PSNR of image ``shown`` against image ``true`` in dB, at most 100."""
    error = float(np.mean(np.square(shown - true), dtype=np.float64))
    return float(-10.0 * np.log10(max(error, 1e-10)))
