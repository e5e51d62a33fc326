"""Define the protocol ``activegamer``, which reproduces the evaluation of [activegamer, code].

Use it to compare with papers that used this evaluation. It does not penalise floaters; use `standard` to judge a map.
"""

from __future__ import annotations

import dataclasses
import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.metrics import lpips
from activestructure_gym.evaluation.metrics.image import channel_psnr, similarities
from activestructure_gym.evaluation.metrics.voxels import matched_distances, nearest_per_voxel
from activestructure_gym.evaluation.protocols.activesplat import SCANNER, scanned_points
from activestructure_gym.evaluation.protocols.base import CameraPath
from activestructure_gym.evaluation.protocols.parallel_views import mean_of_defined, measure_views
from activestructure_gym.geometry import PinholeCamera, invert_rigid, transform_points
from activestructure_gym.ranges import check_ranges

if TYPE_CHECKING:
    from activestructure_gym.evaluation.metrics.lpips import Distance
    from activestructure_gym.evaluation.protocols.held_out_views import HeldOutViews
    from activestructure_gym.ground_truth import GroundTruth
    from activestructure_gym.mapping import GaussianMap

# Centre and radius in metres of the circle of novel views: `src/data/generate_{Replica,MP3D}_NVS_data.py` of
# [activegamer, code].
CIRCLES: dict[str, tuple[tuple[float, float, float], float]] = {
    "office0": ((0.0, 0.0, 0.0), 1.0),
    "office1": ((0.0, 0.0, 0.5), 0.5),
    "office2": ((0.0, 0.0, 0.0), 1.0),
    "office3": ((0.0, 0.0, 0.0), 1.0),
    "office4": ((2.0, 0.0, 0.2), 1.0),
    "room0": ((3.0, 1.0, 0.0), 1.0),
    "room1": ((-2.0, 0.0, 0.0), 1.0),
    "room2": ((3.0, 0.0, -1.0), 1.0),
    "GdvgFV5R1Z5": ((-4.0, 1.0, 1.5), 1.0),
    "gZ6f7yhEvPG": ((0.0, 0.0, 2.0), 1.0),
    "HxpKQynjfin": ((2.0, -3.5, 1.5), 0.5),
    "pLe4wQe7qrG": ((5.0, 0.0, 1.75), 1.0),
    "YmJkqBEsHnH": ((0.0, -2.0, 1.75), 1.0),
}
_GENERATED = 180  # generated poses on the circle
_EVERY = 5  # every fifth frame of the sequence is evaluated, from frame 4 on; frame 0 is the start pose
_TOO_NEAR, _MAX_TOO_NEAR = 0.2, 0.1  # metres; the original program stops if more than 10 % of the pixels are nearer
_WIDTH, _HEIGHT, _FOCAL = 1200, 680, 600.0  # pixels


@dataclass(frozen=True)
class MatchedTruth:
    """Hold the reference data of one scene: points on the true surface, one per voxel, and true views."""

    points: np.ndarray  # [G, 3] metres: in each voxel the sample of the surface nearest to its centre
    centres: np.ndarray  # [G, 3] metres: centres of these voxels
    views: HeldOutViews


_RANGES = {
    "voxel_m": "[0.001, 100]",
    "threshold_m": "(0, 1000]",
    "surface_samples": "[1, 5000000]",
    "image_divisor": "[1, 4]",
    "view_supersample": "[1, 16]",
    "center": "[-1e6, 1e6]",
    "radius": "(0, 1e6]",
}


@dataclass(frozen=True)
class ActiveGamerProtocol:
    """Match the Gaussians' means with the voxels of the surface, and compare masked images on a circle of views.

    Parameters
    ----------
    voxel_m
        Metres. Both point sets are thinned to one point per voxel of this size.
    threshold_m
        Metres. The completion ratio counts distances strictly below it.
    surface_samples
        Evenly spaced samples on the whole mesh.
    scanned
        Count only samples that a scanner would see (`activesplat.scanned_points`), as published scenes are scans. Set
        it to False for a scene that is a scan itself.
    image_divisor
        1 = the original 1200 x 680 pixels, 2 or 4 = smaller images. Only the original size is comparable with papers.
    view_supersample
        Rays per pixel and axis in the true images.
    center, radius
        Circle of views in metres. Default: the published circle of the scene (`CIRCLES`), else a circle around the
        free point with the largest clearance.
    """

    name: ClassVar[str] = "activegamer"
    version: ClassVar[int] = 2  # increase it when the same map would get other numbers

    voxel_m: float = 0.01
    threshold_m: float = 0.05
    surface_samples: int = 200_000
    scanned: bool = True
    image_divisor: int = 1
    view_supersample: int = 1
    center: tuple[float, float, float] | None = None
    radius: float | None = None

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES)
        if self.image_divisor not in (1, 2, 4):
            raise InputError(f"image_divisor must be 1, 2 or 4 (MS-SSIM needs 161 pixels), got {self.image_divisor}")
        if (self.center is None) != (self.radius is None):
            raise InputError("give the circle's center and its radius, or neither")

    def parameters(self) -> dict[str, Any]:
        """Return name, version and all constants for the result file."""
        return {"name": self.name, "version": self.version, **dataclasses.asdict(self)}

    @property
    def camera(self) -> PinholeCamera:
        """Return the original camera, with fewer pixels if ``image_divisor`` is above 1."""
        full = PinholeCamera(_WIDTH, _HEIGHT, _FOCAL, _FOCAL, _WIDTH / 2, _HEIGHT / 2)
        return full.resized(_WIDTH // self.image_divisor, _HEIGHT // self.image_divisor)

    def circle(self, known: GroundTruth) -> tuple[tuple[float, float, float], float]:
        """Return centre and radius of the views: the given ones, the published ones, else `roomiest_circle`.

        Raise `InputError` if the scene has no free space.
        """
        from activestructure_gym.evaluation.protocols.held_out_views import roomiest_circle

        if self.center is not None and self.radius is not None:
            return self.center, self.radius
        name = known.scene.name
        return CIRCLES.get(name) or CIRCLES.get(name.replace("_", "")) or roomiest_circle(known.free_space)

    def truth(self, known: GroundTruth) -> MatchedTruth:
        """Return the reference data of a scene with the ground truth ``known``, cached by the scene's content.

        Raise `InputError` if the scene has no free space, or if more than 10 % of the pixels are nearer than 0.2 m.
        """
        from activestructure_gym.evaluation.protocols.held_out_views import posed_views

        scene = known.scene
        samples = even_samples(known, self.surface_samples, scanned=self.scanned)
        chosen, centres = nearest_per_voxel(samples, self.voxel_m)
        centre, radius = self.circle(known)
        poses = circle_poses(centre, radius)
        views = posed_views(scene, poses, camera=self.camera, supersample=self.view_supersample)
        near = float(np.mean((views.depth > 0) & (views.depth < _TOO_NEAR)))
        if near > _MAX_TOO_NEAR:
            raise InputError(
                f"scene '{scene.name}': {100 * near:.0f} % of the pixels of the views on the circle around {centre} "
                f"with radius {radius} m are nearer than {_TOO_NEAR} m; choose another center and radius"
            )
        return MatchedTruth(samples[chosen], centres, views)

    def evaluate(self, gaussians: GaussianMap, truth: MatchedTruth, path: CameraPath | None = None) -> dict[str, Any]:
        """Return all metrics of a finished map by name.

        The voxel grid for the map is aligned with the first pose of the ``path``; without a path it is aligned with the
        world.
        """
        notes: dict[str, str] = {}
        with lpips.measuring(notes) as distance:
            views = measure_views(lambda index: self._view(gaussians, truth, index, distance), len(truth.views))
        return {
            **self.geometry(gaussians, truth, path),
            "true_samples": len(truth.points),
            **{name: mean_of_defined(view[name] for view in views) for name in ("psnr", "ms_ssim", "lpips")},
            "lpips_weights": lpips.weights_name(),
            "depth_l1_cm": mean_of_defined(view["depth_l1_cm"] for view in views),
            "views": views,
            "notes": notes,
        }

    def geometry(self, gaussians: GaussianMap, truth: MatchedTruth, path: CameraPath | None) -> dict[str, float | None]:
        """Return accuracy (cm), completion (cm) and completion ratio (%); the first two are None for an empty map."""
        start = np.eye(4) if path is None else path.start
        means = np.asarray(gaussians.means, dtype=np.float64)
        chosen, _ = nearest_per_voxel(transform_points(invert_rigid(start), means), self.voxel_m)
        to_true, from_true = matched_distances(means[chosen], truth.points, truth.centres)
        defined = len(chosen) > 0
        return {
            "accuracy_cm": 100.0 * float(to_true.mean()) if defined else None,
            "completion_cm": 100.0 * float(from_true.mean()) if defined else None,
            "completion_ratio": 100.0 * float(np.mean(from_true < self.threshold_m)),
        }

    def _view(
        self, gaussians: GaussianMap, truth: MatchedTruth, index: int, distance: Distance | None
    ) -> dict[str, float | None]:
        from activestructure_gym.splatting import cpu

        pose = truth.views.world_from_camera[index]
        rendering = cpu.render(
            gaussians.parameters, gaussians.count, truth.views.camera, pose, centre_depth=True,
            blur_variance=0.3, threads=1,  # px^2, as in the original's rasteriser
        )  # fmt: skip
        true_depth = truth.views.depth[index]
        # As in the original, the accumulated depth is not divided by alpha, so it is too small where alpha is below 1.
        shown, true, error = masked(rendering.color, truth.views.rgb[index], rendering.depth, true_depth)
        return {
            "psnr": channel_psnr(shown, true),
            "ms_ssim": similarities(shown, true)[1],
            "lpips": None if distance is None else distance(np.clip(shown, 0.0, 1.0), true),
            "depth_l1_cm": 100.0 * float(error.mean()) if len(error) else None,
        }


def masked(
    color: np.ndarray,  # [H, W, 3] float32
    rgb: np.ndarray,  # [H, W, 3] uint8
    depth: np.ndarray,  # [H, W] float32 metres
    true_depth: np.ndarray,  # [H, W] float32 metres, 0 = no surface
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # [H, W, 3] both, [N] metres
    """Return the rendered and the true image, and the absolute depth errors at the N pixels with a true surface.

    Both images are black at pixels without a true surface. The true image has values in [0, 1].
    """
    shown, true, error = np.empty(color.shape), np.empty(color.shape), np.empty(depth.size)
    return shown, true, error[: _mask(color, rgb, depth, true_depth, shown, true, error)]


@kernel
def _mask(
    color: np.ndarray,
    rgb: np.ndarray,
    depth: np.ndarray,
    true_depth: np.ndarray,
    shown: np.ndarray,  # [H, W, 3] out
    true: np.ndarray,  # [H, W, 3] out, 0..1 in single precision
    error: np.ndarray,  # [H * W] out
) -> int:  # number of pixels with a true surface
    """Write the masked images, and the depth errors of the pixels with a true surface in row order."""
    count = 0
    for i in range(color.shape[0]):
        for j in range(color.shape[1]):
            if true_depth[i, j] > 0.0:
                for c in range(3):
                    shown[i, j, c] = color[i, j, c]
                    true[i, j, c] = np.float32(rgb[i, j, c]) / np.float32(255.0)
                error[count] = abs(depth[i, j] - true_depth[i, j])
                count += 1
            else:
                for c in range(3):
                    shown[i, j, c] = true[i, j, c] = 0.0
    return count


def even_samples(known: GroundTruth, count: int, *, scanned: bool) -> np.ndarray:  # [at most count, 3] metres
    """Sample evenly spaced points on the whole surface of a scene with trimesh, as the original does.

    With ``scanned``, only those that a scanner would see are returned; raise `InputError` as `scanned_points` does. The
    result is cached by the scene's content.
    """
    from activestructure_gym.scenes.cache import cached_arrays

    scene = known.scene

    def compute() -> dict[str, np.ndarray]:
        import trimesh

        mesh = trimesh.Trimesh(scene.mesh.vertices, scene.mesh.faces, process=False)
        seed = int(scene.draw_key[32:40], 16)
        # trimesh warns on every scene that fewer points fit than requested, which is expected for this method.
        log = logging.getLogger("trimesh")
        level = log.level
        log.setLevel(logging.ERROR)
        try:
            points, _ = trimesh.sample.sample_surface_even(mesh, count, seed=seed)
        finally:
            log.setLevel(level)
        if scanned:
            points = scanned_points(known, points, np.random.default_rng(seed))
        return {"points": np.asarray(points, dtype=np.float32)}

    key = f"even-samples-v2-{SCANNER if scanned else 'whole'}-{scene.content_hash[:32]}-{count}"
    return cached_arrays(key, compute, {"points": ("f4", 2)})["points"].astype(np.float64)


def circle_indices() -> np.ndarray:  # [36]
    """Return the indices of the evaluated frames: 4, 9, ... 179, as in the original."""
    return np.arange(_EVERY - 1, _GENERATED, _EVERY)


def circle_poses(center: tuple[float, float, float], radius: float) -> np.ndarray:  # [36, 4, 4] world_from_camera
    """Return poses on a horizontal circle that face its centre, frame k at the angle 2 pi (k - 1) / 180."""
    from activestructure_gym.geometry import look_along

    angles = 2.0 * np.pi * (circle_indices() - 1) / _GENERATED
    outwards = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    return np.stack([look_along(np.asarray(center) + radius * away, -away) for away in outwards])
