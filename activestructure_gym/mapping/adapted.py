"""Adapt a mapper that has only the six members of `MapperProtocol` to the interface `KeyframeMapper`.

Features and observations need `KeyframeMapper`, for example its PSNR per keyframe.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame, unit_rgb
from activestructure_gym.mapping.base import BaseMapperConfig, MapperProtocol, MappingReport
from activestructure_gym.mapping.gaussian_map import GaussianMap
from activestructure_gym.mapping.keyframe_mapper import KeyframeMapper, psnr
from activestructure_gym.splatting import Rendering

_NAMES = ("observe", "refine", "render", "render_depth_alpha", "keyframes", "map")


def keyframe_mapper(mapper: MapperProtocol, config: BaseMapperConfig) -> KeyframeMapper:
    """Return the mapper as a `KeyframeMapper`; an adapter is used if it is not one.

    Raises `InputError` if the mapper lacks a member of `MapperProtocol`.
    """
    if isinstance(mapper, KeyframeMapper):
        return mapper
    missing = [name for name in _NAMES if not hasattr(mapper, name)]
    if missing:
        raise InputError(
            f"the mapper {short_repr(config.name)} has no {', '.join(missing)}; a mapper needs all of {_NAMES}"
        )
    return AdaptedMapper(mapper, config)


class AdaptedMapper(KeyframeMapper):
    """Call another mapper, count its mapping events, and measure the PSNR of its keyframes on its renderings."""

    def __init__(self, mapper: MapperProtocol, config: BaseMapperConfig) -> None:
        self.adapted = mapper
        super().__init__(config, np.random.default_rng(0))  # the base class needs a generator, which is never used

    @property
    def map(self) -> GaussianMap:
        """Return the Gaussians of the adapted mapper."""
        return self.adapted.map

    @map.setter
    def map(self, gaussians: GaussianMap) -> None:
        pass

    def observe(self, frame: Frame, *, iterations: int | None = None) -> MappingReport:
        """Call ``observe`` of the adapted mapper, and measure the PSNR of the new keyframe."""
        self.events += 1
        self._before_steps()
        report = self.adapted.observe(frame, iterations=iterations)
        self._after_steps()
        self._store.append(self.adapted.keyframes[-1], new_share=report.new_share)
        self._measure_psnr(self._store.stalest(1))
        return report

    def refine(self, iterations: int, *, keyframe_indices: Sequence[int] | None = None) -> MappingReport:
        """Call ``refine`` of the adapted mapper."""
        self.events += 1
        self._before_steps()
        report = self.adapted.refine(iterations, keyframe_indices=keyframe_indices)
        self._after_steps()
        return report

    def render(self, camera: PinholeCamera, world_from_camera: np.ndarray) -> Rendering:
        """Render colour, depth and alpha from a pose with the adapted mapper."""
        return self.adapted.render(camera, world_from_camera)

    def render_depth_alpha(
        self,
        camera: PinholeCamera,
        world_from_camera: np.ndarray,  # [C, 4, 4] poses
    ) -> tuple[np.ndarray, np.ndarray]:  # accumulated depth [C, H, W] in metres, alpha [C, H, W]
        """Render accumulated depth and alpha from C poses with the adapted mapper."""
        return self.adapted.render_depth_alpha(camera, world_from_camera)

    def _measure_psnr(self, indices: Sequence[int]) -> None:
        for index in indices:
            frame = self._store.frames[index]
            image = np.clip(self.render(frame.camera, frame.world_from_camera).color, 0.0, 1.0)
            self._store.record_psnr(index, psnr(image, unit_rgb(frame)))
