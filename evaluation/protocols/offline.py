"""Define the protocol ``offline``: train a map from scratch on the keyframes of a run, and measure it by `standard`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.protocols.base import CameraPath
from activestructure_gym.evaluation.protocols.standard import StandardProtocol, Truth
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.ranges import check_ranges

if TYPE_CHECKING:
    from activestructure_gym.mapping import GaussianMap, MapperProtocol
    from activestructure_gym.scenes import Scene

_RANGES = {
    "iterations": "[0, 1000000]",
    "image_width": "[16, 4096]",
    "image_supersample": "[1, 16]",
    "seed": "[0, 4294967295]",
}
# Steps between two prunings. The mapper skips the Gaussians outside a view, with a margin that grows with the steps.
_STEPS = 10


@dataclass(frozen=True)
class OfflineProtocol(StandardProtocol):
    """Measure the views that a planner chose, by a map that is trained on them offline.

    The map of the run is ignored. Every keyframe is drawn without noise at its exact pose. The default recipe of the
    mapper seeds a new map from the keyframes in their order, without optimisation. Then all parameters but the
    opacities are optimised in equally many steps for every run, whatever its mapper and its number of keyframes.
    The fields of `StandardProtocol` are the constants by which the new map is measured.

    Parameters
    ----------
    iterations
        Optimisation steps, each on one keyframe. All keyframes are shuffled repeatedly.
    image_width
        Width of the drawn keyframes in pixels. Field of view and aspect ratio are the sensor's.
    image_supersample
        Rays per pixel and axis in the drawn keyframes.
    seed
        Seed of the shuffling.
    """

    name: ClassVar[str] = "offline"
    # Increase it when the same keyframes would get other numbers: also when `StandardProtocol` or the default recipe of
    # the mapper changes.
    version: ClassVar[int] = 1

    iterations: int = 1000
    image_width: int = 320
    image_supersample: int = 4
    seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, _RANGES)

    def evaluate(self, gaussians: GaussianMap, truth: Truth, path: CameraPath | None = None) -> dict[str, Any]:
        """Return all metrics of the map that is trained on the keyframes of the ``path``; ``gaussians`` is not used.

        The metrics are those of `StandardProtocol`, and the numbers of ``keyframes`` and of new ``gaussians``. Raise
        `InputError` without a path or without the scene that draws the keyframes.
        """
        if path is None or truth.scene is None:
            missing = "their poses: give --poses trajectory.npz" if path is None else "the scene to draw them"
            raise InputError(f"protocol '{self.name}' trains on the keyframes of a run, and needs {missing}")
        mapper = self.trained(truth.scene, path)
        sizes = {"keyframes": len(path.keyframes), "gaussians": mapper.map.count}
        return super().evaluate(mapper.map, truth, path) | sizes

    def trained(self, scene: Scene, path: CameraPath) -> MapperProtocol:
        """Return a mapper whose map is trained on the keyframes of the ``path``, drawn in the ``scene``."""
        from activestructure_gym.mapping import MapperConfig
        from activestructure_gym.sensors.renderer import drawn_images

        mapper = MapperConfig(refine_shapes=True, psnr_refresh=0).make(np.random.default_rng(self.seed), scene.bounds)
        height = round(self.image_width * path.camera.height / path.camera.width)
        camera = path.camera.resized(self.image_width, height)
        images = drawn_images(
            scene, camera, path.keyframes, supersample=self.image_supersample, max_range=path.max_range
        )
        for (rgb, depth), pose in zip(images, path.keyframes, strict=True):
            mapper.observe(Frame(rgb, depth, pose, camera), iterations=0)
        order = shuffled(len(path.keyframes), self.iterations, self.seed)
        for start in range(0, len(order), _STEPS):
            part = order[start : start + _STEPS]
            mapper.refine(len(part), keyframe_indices=part)
        return mapper


def shuffled(count: int, length: int, seed: int) -> list[int]:
    """Return ``length`` of the indices 0 to ``count`` - 1, shuffled repeatedly; none if ``count`` is 0."""
    rng = np.random.default_rng(seed)
    order: list[int] = []
    while count and len(order) < length:
        order += rng.permutation(count).tolist()
    return order[:length]
