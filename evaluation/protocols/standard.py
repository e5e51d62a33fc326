"""Define the protocol ``standard``, which measures every run."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal, get_args

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.metrics import (
    GeometryScores,
    SurfaceSamples,
    depth_l1,
    geometry_scores,
    lpips,
    psnr,
)
from activestructure_gym.evaluation.metrics.fusion import FusedSurface, check_fusing
from activestructure_gym.evaluation.metrics.geometry import streamed_distances, streamed_scores
from activestructure_gym.evaluation.metrics.image import MS_SSIM_SIDE, similarities
from activestructure_gym.evaluation.metrics.surface_points import SurfacePoints
from activestructure_gym.evaluation.protocols.base import CameraPath
from activestructure_gym.evaluation.protocols.parallel_views import mean_of_defined, measure_views
from activestructure_gym.evaluation.protocols.visibility import seen_by_keyframes
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.ground_truth.observable import SIGHT_MARGIN
from activestructure_gym.ranges import check_ranges

if TYPE_CHECKING:
    from activestructure_gym.evaluation.metrics.lpips import Distance
    from activestructure_gym.evaluation.protocols.held_out_views import HeldOutViews
    from activestructure_gym.ground_truth import GroundTruth
    from activestructure_gym.mapping import GaussianMap
    from activestructure_gym.scenes import Scene
    from activestructure_gym.splatting.cpu import Rendering

PointsSource = Literal["both", "means"]
ViewSource = Literal["free_space", "recorded"]


@dataclass(frozen=True)
class Truth:
    """Hold surface samples and held-out views of one scene, with which a map is compared."""

    surface: SurfaceSamples
    views: HeldOutViews
    scene: Scene | None = None  # with the mesh for tests of visibility; without it ``observed`` is None


# Samples and views must fit into memory; SSIM needs 11 x 11 pixels.
_RANGES = {
    "opacity_threshold": "[0, 1)",
    "threshold_m": "(0, 1000]",
    "surface_samples": "[1, 5000000]",
    "views": "[1, 2000]",
    **dict.fromkeys(("view_width", "view_height"), "[11, 4096]"),
    "view_fov_deg": "[0.1, 179]",
    "view_supersample": "[1, 16]",
    "coverage_alpha": "[0, 1]",
    **dict.fromkeys(("tsdf_voxel_m", "tsdf_truncation_m"), "[0.001, 100]"),
    "tsdf_image_width": "[16, 4096]",
    "tsdf_samples_per_m2": "[0, 100000]",
    "sight_margin_m": "[0, 1]",
}


@dataclass(frozen=True)
class StandardProtocol:
    """Measure the geometry of a map against the observable surface, and its renderings at held-out views.

    Parameters
    ----------
    opacity_threshold
        Minimum opacity of a Gaussian whose mean counts as a reconstructed point.
    threshold_m
        Metres. Completion ratio, precision and F-score count distances strictly below it.
    surface_samples
        Samples on the whole mesh. The samples visible from free space (about half) represent the true surface.
        Also the minimum number of points on the TSDF surface.
    views
        Number of held-out views.
    view_width, view_height, view_fov_deg
        Size in pixels and horizontal field of view of the held-out views, independent of the sensor. Image metrics of
        different sizes are not comparable.
    view_supersample
        Rays per pixel and axis in the true images.
    view_source
        ``"free_space"`` (drawn at random) or ``"recorded"`` (the scene's recorded sequence).
    coverage_alpha
        A rendered pixel counts as covered if its alpha is above this value.
    points_source
        ``"both"``, or ``"means"`` to leave out the TSDF surface.
    tsdf_voxel_m, tsdf_truncation_m
        Voxel size and truncation distance of the TSDF surface, metres.
    tsdf_image_width
        Width in pixels of the fused depth images, which have the sensor's field of view.
    tsdf_samples_per_m2
        Minimum density of points on the TSDF surface. At a tenth of the default, 400 points per m^2, 1 % of all places
        have no point within 6 cm by chance.
    sight_margin_m
        Metres. Mesh within this distance in front of a sample does not block the line of sight from a keyframe.
    """

    name: ClassVar[str] = "standard"
    version: ClassVar[int] = 5  # increase it when the same map would get other numbers

    opacity_threshold: float = 0.5
    threshold_m: float = 0.05
    surface_samples: int = 200_000
    views: int = 64
    view_width: int = 320
    view_height: int = 180
    view_fov_deg: float = 90.0
    view_supersample: int = 4
    view_source: ViewSource = "free_space"
    coverage_alpha: float = 0.5
    points_source: PointsSource = "both"
    tsdf_voxel_m: float = 0.02
    tsdf_truncation_m: float = 0.06
    tsdf_image_width: int = 320
    tsdf_samples_per_m2: float = 4000.0
    sight_margin_m: float = SIGHT_MARGIN

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES)
        if self.points_source not in get_args(PointsSource):
            raise InputError(
                f"points_source must be one of {', '.join(get_args(PointsSource))}, got '{self.points_source}'"
            )
        if self.tsdf_voxel_m > self.tsdf_truncation_m:
            raise InputError(
                f"tsdf_truncation_m must be at least tsdf_voxel_m ({self.tsdf_voxel_m}), got {self.tsdf_truncation_m}"
            )
        if self.view_source not in get_args(ViewSource):
            raise InputError(f"view_source must be one of {', '.join(get_args(ViewSource))}, got '{self.view_source}'")

    def parameters(self) -> dict[str, Any]:
        """Return name, version and all constants for the result file."""
        return {"name": self.name, "version": self.version, **dataclasses.asdict(self)}

    @property
    def camera(self) -> PinholeCamera:
        """Return the camera of the views drawn in free space."""
        return PinholeCamera.from_size(self.view_width, self.view_height, self.view_fov_deg)

    def truth(self, known: GroundTruth) -> Truth:
        """Return the observable surface and the held-out views of a scene, both cached by its content.

        Raise `InputError` if the scene is too large for the TSDF surface to be fused.
        """
        from activestructure_gym.evaluation.protocols.held_out_views import free_space_views, recorded_views
        from activestructure_gym.ground_truth.observable import observable_surface_of

        seen = observable_surface_of(known.scene, known.free_space, self.surface_samples)
        if self.points_source == "both":
            check_fusing(known.scene.name, seen.area, self.tsdf_voxel_m, self.tsdf_truncation_m)
        surface = SurfaceSamples(seen.points, seen.normals, seen.area)
        if self.view_source == "recorded":
            return Truth(surface, recorded_views(known.scene, count=self.views), known.scene)
        views = free_space_views(known, count=self.views, camera=self.camera, supersample=self.view_supersample)
        return Truth(surface, views, known.scene)

    def evaluate(self, gaussians: GaussianMap, truth: Truth, path: CameraPath | None = None) -> dict[str, Any]:
        """Return all metrics of a finished map by name.

        Image metrics are means over the held-out views; the entry ``views`` lists them for each view. Geometry metrics
        with the prefix ``tsdf_`` measure the TSDF surface, which needs the ``path``. Geometry metrics without this
        prefix measure the means of the Gaussians. ``observed`` is the share in % of the true surface that was visible
        in at least one keyframe, mapped or not; it needs the ``path`` too. An undefined metric is None, and the entry
        ``notes`` has the reason.
        """
        notes: dict[str, str] = {}
        means = geometry_scores(self.points(gaussians), truth.surface, threshold_m=self.threshold_m)
        fused = self._fused_scores(gaussians, truth, path, notes)
        views = self.view_scores(gaussians, truth, notes)
        return {
            **dataclasses.asdict(means),
            **fused,
            "observed": self._observed(truth, path, notes),
            "true_area_m2": truth.surface.area,
            "true_samples": len(truth.surface.points),
            **{name: mean_of_defined(view[name] for view in views) for name in ("psnr", "ssim", "ms_ssim", "lpips")},
            "lpips_weights": lpips.weights_name(),
            "depth_l1_cm": mean_of_defined(view["depth_l1_cm"] for view in views),
            "view_coverage": mean_of_defined(view["coverage"] for view in views),
            "views": views,
            "notes": notes,
        }

    def _observed(self, truth: Truth, path: CameraPath | None, notes: dict[str, str]) -> float | None:
        share = self.observed(truth, path)
        if share is None:
            missing = "poses of keyframes" if path is None else "mesh"
            notes["observed"] = f"no {missing} came with the {'map' if path is None else 'truth'}"
        return share

    def observed(self, truth: Truth, path: CameraPath | None) -> float | None:
        """Return the share in % of the true surface that was visible in at least one keyframe of the path.

        Return None without poses or without a mesh.
        """
        if path is None or truth.scene is None:
            return None
        return 100.0 * float(np.mean(seen_by_keyframes(truth.surface.points, path, truth.scene, self.sight_margin_m)))

    def _fused_scores(
        self, gaussians: GaussianMap, truth: Truth, path: CameraPath | None, notes: dict[str, str]
    ) -> dict[str, float | None]:
        scores, area = GeometryScores(None, None, None, None, None, None), None
        try:
            if path is None:
                raise InputError("no poses of keyframes came with the map")
            points = self.on_surface(self.surface(gaussians, path).pieces)
            scores = streamed_scores(
                points.pieces(), points.count, truth.surface, threshold_m=self.threshold_m, to_samples=False
            )
            area = points.area
        except InputError as error:
            notes["tsdf"] = str(error)
        found = dataclasses.asdict(scores)
        del found["sample_accuracy_cm"]
        return {f"tsdf_{name}": value for name, value in found.items()} | {"tsdf_area_m2": area}

    def surface(self, gaussians: GaussianMap, path: CameraPath) -> FusedSurface:
        """Render depth images of the map at the keyframes of the path and fuse them into a surface (TSDF).

        Raise `InputError` if ``points_source`` is ``"means"``, or if the surface is too large.
        """
        if self.points_source != "both":
            raise InputError("this protocol asks for means only")
        size = (self.tsdf_image_width, round(self.tsdf_image_width * path.camera.height / path.camera.width))
        camera = path.camera.resized(*size)
        return FusedSurface(
            lambda poses: self._surface_depth(gaussians, camera, poses),
            camera,
            path.keyframes,
            voxel=self.tsdf_voxel_m,
            truncation=self.tsdf_truncation_m,
        )

    def _surface_depth(self, gaussians: GaussianMap, camera: PinholeCamera, poses: np.ndarray) -> np.ndarray:
        """Render the surface depth of the map at ``poses`` [K, 4, 4]: [K, H, W] metres, 0 = no surface."""
        from activestructure_gym.splatting.surface_depth import surface_depth

        return surface_depth(gaussians.parameters, gaussians.count, camera, poses)

    def on_surface(self, triangles: Callable[[], Iterable[np.ndarray]]) -> SurfacePoints:
        """Sample points uniformly by area on triangles, of which ``triangles`` returns the corners [n, 3, 3] in pieces.

        The points are so dense that the distance to the nearest point approximates the distance to the surface.
        """
        return SurfacePoints(triangles, per_m2=self.tsdf_samples_per_m2, least=self.surface_samples)

    def view_scores(self, gaussians: GaussianMap, truth: Truth, notes: dict[str, str]) -> list[dict[str, float | None]]:
        """Return the image metrics of every held-out view; add the reasons for undefined metrics to ``notes``."""
        if min(truth.views.camera.width, truth.views.camera.height) < MS_SSIM_SIDE:
            notes["ms_ssim"] = f"its five scales need images of at least {MS_SSIM_SIDE} pixels on the smaller side"
        with lpips.measuring(notes) as distance:
            return measure_views(lambda index: self._view(gaussians, truth, index, distance), len(truth.views))

    def checkpoint(
        self,
        gaussians: GaussianMap,
        truth: Truth,
        path: CameraPath | None = None,
        *,
        images: bool,
        samples: int,
    ) -> dict[str, float]:
        """Return the scores of an unfinished map for its convergence curve.

        - The completion ratio is computed on about ``samples`` points of the true surface. So is ``observed``, if the
          ``path`` so far is given.
        - Precision and accuracy are computed on about ``samples`` means of Gaussians, if there are any.
        - ``images`` adds PSNR and depth error, averaged over all held-out views.
        """
        every = slice(None, None, max(1, len(truth.surface.points) // samples))
        part = dataclasses.replace(
            truth.surface, points=truth.surface.points[every], normals=truth.surface.normals[every]
        )
        points = self.points(gaussians)
        near = streamed_distances(part.points, [points]) < self.threshold_m
        found = {"completion_ratio": 100.0 * float(np.mean(near))}
        if len(points):
            off = truth.surface.discs.query(points[:: max(1, len(points) // samples)])[0]
            found["precision"] = 100.0 * float(np.mean(off < self.threshold_m))
            found["accuracy_cm"] = 100.0 * float(off.mean())
        if images:
            found |= self._image_scores(gaussians, truth)
        observed = self.observed(dataclasses.replace(truth, surface=part), path)
        if observed is not None:
            found["observed"] = observed
        return found

    def _image_scores(self, gaussians: GaussianMap, truth: Truth) -> dict[str, float]:
        """Return the mean PSNR (dB) and the mean depth error (cm) over the held-out views in which they are defined."""

        def look(index: int) -> tuple[float, float | None]:
            rendering = self._render(gaussians, truth, index, threads=1)
            fidelity = psnr(np.clip(rendering.color, 0.0, 1.0), _unit(truth.views.rgb[index]))
            return fidelity, self._depth_error(rendering, truth, index)

        looks = measure_views(look, len(truth.views))
        means = {"psnr": mean_of_defined(p for p, _ in looks), "depth_l1_cm": mean_of_defined(d for _, d in looks)}
        return {name: value for name, value in means.items() if value is not None}

    def points(self, gaussians: GaussianMap) -> np.ndarray:  # [P, 3]
        """Return the reconstructed points: the means of the Gaussians with at least the threshold's opacity, metres."""
        return gaussians.means[gaussians.opacities >= self.opacity_threshold]

    def picture(self, gaussians: GaussianMap, truth: Truth, index: int) -> np.ndarray:  # [H, W, 3] 0..1
        """Render the colour image of the map at held-out view ``index``; pixels without a Gaussian are black."""
        return np.clip(self._render(gaussians, truth, index).color, 0.0, 1.0)

    def _render(self, gaussians: GaussianMap, truth: Truth, index: int, threads: int | None = None) -> Rendering:
        from activestructure_gym.splatting import cpu

        pose = truth.views.world_from_camera[index]
        return cpu.render(gaussians.parameters, gaussians.count, truth.views.camera, pose, threads=threads)

    def _view(
        self, gaussians: GaussianMap, truth: Truth, index: int, distance: Distance | None
    ) -> dict[str, float | None]:
        rendering = self._render(gaussians, truth, index, threads=1)
        picture, true = np.clip(rendering.color, 0.0, 1.0), _unit(truth.views.rgb[index])
        single, multi = similarities(picture, true)
        return {
            "psnr": psnr(picture, true),
            "ssim": single,
            "ms_ssim": multi,
            "lpips": None if distance is None else distance(picture, true),
            "depth_l1_cm": self._depth_error(rendering, truth, index),
            "coverage": float((rendering.alpha > self.coverage_alpha).mean()),
        }

    def _depth_error(self, rendering: Rendering, truth: Truth, index: int) -> float | None:  # cm
        covered = rendering.alpha > self.coverage_alpha
        depth = np.where(covered, rendering.depth / np.where(covered, rendering.alpha, 1.0), 0.0)
        error = depth_l1(depth, truth.views.depth[index])
        return None if error is None else 100.0 * error


def _unit(rgb: np.ndarray) -> np.ndarray:
    return rgb.astype(np.float32) / np.float32(255.0)
