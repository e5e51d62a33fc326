"""The protocol ``standard``: what this project measures unless asked for something else (method.md, section 8)."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.metrics import (
    SurfaceSamples,
    completion_distances,
    depth_l1,
    geometry_scores,
    psnr,
)
from activestructure_gym.evaluation.metrics.image import MS_SSIM_SIDE, similarities
from activestructure_gym.evaluation.protocols.base import CameraPath
from activestructure_gym.evaluation.protocols.looks import every_view, mean_of_known
from activestructure_gym.geometry import PinholeCamera

if TYPE_CHECKING:
    from activestructure_gym.evaluation.views import HeldOutViews
    from activestructure_gym.mapping import GaussianMap
    from activestructure_gym.scenes import Scene
    from activestructure_gym.splatting.cpu import Rendering

VIEW_SOURCES = ("free_space", "recorded")


@dataclass(frozen=True)
class Truth:
    """What a map of one scene is compared with."""

    surface: SurfaceSamples
    views: HeldOutViews


@dataclass(frozen=True)
class StandardProtocol:
    """Geometry of the solid Gaussians against the surface that can be seen; images from views nobody planned for."""

    name: ClassVar[str] = "standard"
    version: ClassVar[int] = 2  # moves whenever the same map would get another number

    opacity_threshold: float = 0.5  # a Gaussian is a reconstructed point (its mean) from this opacity on
    threshold_m: float = 0.05  # metres; C.R., precision and F-score count distances strictly below it
    surface_samples: int = 200_000  # on the whole mesh; those that some free pose can see are the truth, about half
    views: int = 64
    view_width: int = 320  # pixels, whatever the sensor's size: numbers of other sizes cannot be compared
    view_height: int = 180
    view_fov_deg: float = 90.0  # horizontal
    view_supersample: int = 4  # rays per pixel and axis in the true views
    view_source: str = "free_space"  # or "recorded": the views that came with the scene
    coverage_alpha: float = 0.5  # a rendered pixel shows the map where its alpha is above this

    def __post_init__(self) -> None:
        if not 0.0 <= self.opacity_threshold < 1.0:
            raise InputError(f"opacity_threshold must lie in [0, 1), got {self.opacity_threshold}")
        if not self.threshold_m > 0:
            raise InputError(f"threshold_m must be above 0 metres, got {self.threshold_m}")
        if min(self.surface_samples, self.views, self.view_supersample) < 1:
            raise InputError("surface_samples, views and view_supersample must be at least 1")
        if min(self.view_width, self.view_height) < 11:
            raise InputError(f"held-out views need 11 x 11 pixels for SSIM, got {self.view_width}x{self.view_height}")
        if self.view_source not in VIEW_SOURCES:
            raise InputError(f"view_source must be one of {', '.join(VIEW_SOURCES)}, got '{self.view_source}'")

    def parameters(self) -> dict[str, Any]:
        """Name, version and every constant, for the result file."""
        return {"name": self.name, "version": self.version, **dataclasses.asdict(self)}

    @property
    def camera(self) -> PinholeCamera:
        """The camera of the views drawn in free space."""
        return PinholeCamera.from_size(self.view_width, self.view_height, self.view_fov_deg)

    def truth(self, scene: Scene) -> Truth:
        """The observable surface and the held-out views of a scene (both cached by its content)."""
        from activestructure_gym.evaluation.views import free_space_views, recorded_views
        from activestructure_gym.scenes.observable import observable_surface_of

        seen = observable_surface_of(scene, samples=self.surface_samples)
        surface = SurfaceSamples(seen.points, seen.normals, seen.area)
        if self.view_source == "recorded":
            return Truth(surface, recorded_views(scene, count=self.views))
        views = free_space_views(scene, count=self.views, camera=self.camera, supersample=self.view_supersample)
        return Truth(surface, views)

    def evaluate(self, gaussians: GaussianMap, truth: Truth, path: CameraPath | None = None) -> dict[str, Any]:
        """All numbers of a finished map. ``views`` lists those of every view; the rest are their means.

        What is not defined is None, and ``notes`` says why.
        """
        notes: dict[str, str] = {}
        geometry = geometry_scores(self.points(gaussians), truth.surface, threshold_m=self.threshold_m)
        views = every_view(lambda index: self._view(gaussians, truth, index), len(truth.views))
        if views[0]["ms_ssim"] is None:
            notes["ms_ssim"] = f"its five scales need images of at least {MS_SSIM_SIDE} pixels on the smaller side"
        return {
            **dataclasses.asdict(geometry),
            "true_area_m2": truth.surface.area,
            "true_samples": len(truth.surface.points),
            **{name: mean_of_known(view[name] for view in views) for name in ("psnr", "ssim", "ms_ssim", "lpips")},
            "depth_l1_cm": mean_of_known(view["depth_l1_cm"] for view in views),
            "view_coverage": mean_of_known(view["coverage"] for view in views),
            "views": views,
            "notes": notes,
        }

    def checkpoint(self, gaussians: GaussianMap, truth: Truth, *, views: int, samples: int) -> dict[str, float]:
        """C.R. and PSNR of an unfinished map on about ``samples`` surface points and the first ``views`` views."""
        every = slice(None, None, max(1, len(truth.surface.points) // samples))
        part = dataclasses.replace(
            truth.surface, points=truth.surface.points[every], normals=truth.surface.normals[every]
        )
        distances = completion_distances(part, self.points(gaussians))
        count = min(views, len(truth.views))
        return {
            "completion_ratio": 100.0 * float(np.mean(distances < self.threshold_m)),
            "psnr": _mean(psnr(self.picture(gaussians, truth, i), _unit(truth.views.rgb[i])) for i in range(count)),
        }

    def points(self, gaussians: GaussianMap) -> np.ndarray:  # [P, 3]
        """The reconstructed points: the means of the solid Gaussians."""
        return gaussians.means[gaussians.opacities >= self.opacity_threshold]

    def picture(self, gaussians: GaussianMap, truth: Truth, index: int) -> np.ndarray:  # [H, W, 3] 0..1
        """The map as seen from held-out view ``index``; black where there is none."""
        return np.clip(self._render(gaussians, truth, index).color, 0.0, 1.0)

    def _render(self, gaussians: GaussianMap, truth: Truth, index: int, threads: int | None = None) -> Rendering:
        from activestructure_gym.splatting import cpu

        pose = truth.views.world_from_camera[index]
        return cpu.render(gaussians.parameters, gaussians.count, truth.views.camera, pose, threads=threads)

    def _view(self, gaussians: GaussianMap, truth: Truth, index: int) -> dict[str, float | None]:
        rendering = self._render(gaussians, truth, index, threads=1)
        picture, true = np.clip(rendering.color, 0.0, 1.0), _unit(truth.views.rgb[index])
        covered = rendering.alpha > self.coverage_alpha
        depth = np.where(covered, rendering.depth / np.where(covered, rendering.alpha, 1.0), 0.0)
        error = depth_l1(depth, truth.views.depth[index])
        single, multi = similarities(picture, true)
        return {
            "psnr": psnr(picture, true),
            "ssim": single,
            "ms_ssim": multi,
            "lpips": None,
            "depth_l1_cm": None if error is None else 100.0 * error,
            "coverage": float(covered.mean()),
        }


def _unit(rgb: np.ndarray) -> np.ndarray:
    return rgb.astype(np.float32) / np.float32(255.0)


def _mean(values: Any) -> float:
    return float(np.mean(list(values)))
