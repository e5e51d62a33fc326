"""Define the protocol ``activesplat``, which reproduces the evaluation of [activesplat, code] and of [anm_s, code].

It measures the exploration alone: a true point is complete if any frame saw a surface near it, mapped or not.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.metrics.geometry import nearest_distances, streamed_distances
from activestructure_gym.evaluation.protocols.base import CameraPath
from activestructure_gym.geometry import transform_points
from activestructure_gym.ranges import check_ranges

if TYPE_CHECKING:
    from activestructure_gym.ground_truth import GroundTruth
    from activestructure_gym.mapping import GaussianMap
    from activestructure_gym.scenes import Scene

_RANGES = {
    "surface_samples": "[1, 5000000]",
    "threshold_m": "(0, 1000]",
    "farthest_m": "(0, 1000]",
    "range_m": "(0, 1000]",
    "image_width": "[2, 4096]",
}


SCANNER_HEIGHTS = (0.8, 2.0)  # metres above the ground
SCANNER_CLEARANCE = 0.5  # metres to the nearest surface
SCANNER = f"{SCANNER_HEIGHTS[0]}-{SCANNER_HEIGHTS[1]}-{SCANNER_CLEARANCE}"  # names the scanner in keys of the cache


@dataclass(frozen=True)
class SampledTruth:
    """Hold samples on the surface of a scene, and the scene."""

    points: np.ndarray  # [S, 3] metres, uniform by area
    scene: Scene


def sampled_truth(known: GroundTruth, count: int, *, scanned: bool) -> SampledTruth:
    """Return ``count`` samples uniform by area on the whole mesh; with ``scanned`` only those that a scanner would see.

    The samples are drawn with the `draw_key` of the scene. Raise `InputError` as `scanned_points` does.
    """
    from activestructure_gym.ground_truth.surface_samples import uniform_samples
    from activestructure_gym.scenes.cache import cached_arrays

    scene = known.scene

    def compute() -> dict[str, np.ndarray]:
        rng = np.random.default_rng(int(scene.draw_key[40:48], 16))
        points = uniform_samples(scene.mesh.vertices, scene.mesh.faces, count, rng)[0]
        return {"points": (scanned_points(known, points, rng) if scanned else points).astype(np.float32)}

    key = f"scanned-samples-v1-{SCANNER if scanned else 'whole'}-{scene.content_hash[:32]}-{count}"
    return SampledTruth(cached_arrays(key, compute, {"points": ("f4", 2)})["points"].astype(np.float64), scene)


def scanned_points(known: GroundTruth, points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return those of the ``points`` [N, 3] on the surface of a scene that a scanner would see.

    The papers use meshes that were scanned in rooms, so backs of furniture and inner faces are missing in them.
    Modelled scenes have these faces. A scanner sees a sample if one of 400 free places does, 0.8 to 2 m above the
    ground and at least 0.5 m from all surfaces. Raise `InputError` if a scene has no such place, or if no sample is
    visible.
    """
    from activestructure_gym.ground_truth.observable import first_viewpoint

    space = known.free_space
    clearance = min(SCANNER_CLEARANCE, 0.8 * float(space.clearance.max()))
    eyes = space.sample_positions(400, rng, min_clearance=clearance, heights=SCANNER_HEIGHTS)
    points = points[first_viewpoint(known.scene, points, eyes) >= 0]
    if not len(points):
        raise InputError(f"scene '{known.scene.name}' has no surface in sight of a scanner {SCANNER_HEIGHTS} m high")
    return points


@dataclass(frozen=True)
class ActiveSplatProtocol:
    """Measure how much of the surface is near a point that any frame of the episode saw.

    Every frame is drawn again without noise, at its exact pose. The map is not used.

    Parameters
    ----------
    surface_samples
        Samples on the whole mesh.
    scanned
        Whether samples that a scanner would not see are left out (`sampled_truth`). False is the original's program,
        whose meshes are scans.
    threshold_m
        Metres. The completion ratio counts distances strictly below it.
    farthest_m
        Metres. Larger distances count as this one in ``completion_cm``.
    range_m
        Metres of depth. Surface farther away is not seen, whatever the range of the planner's sensor was: the original
        draws frames with its simulator's range, and lets its planner use less of it.
    image_width
        Width of the drawn images in pixels, with the sensor's field of view and aspect ratio. The default is the
        original's: half of its sensor's 256 pixels.
    """

    name: ClassVar[str] = "activesplat"
    version: ClassVar[int] = 2  # increase it when the same frames would get other numbers

    surface_samples: int = 200_000
    scanned: bool = True
    threshold_m: float = 0.05
    farthest_m: float = 1.0
    range_m: float = 10.0
    image_width: int = 128

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES)

    def parameters(self) -> dict[str, Any]:
        """Return name, version and all constants for the result file."""
        return {"name": self.name, "version": self.version, **dataclasses.asdict(self)}

    def truth(self, known: GroundTruth) -> SampledTruth:
        """Return samples on the surface of the scene (`sampled_truth`)."""
        return sampled_truth(known, self.surface_samples, scanned=self.scanned)

    def evaluate(self, gaussians: GaussianMap, truth: SampledTruth, path: CameraPath | None = None) -> dict[str, Any]:
        """Return completion (cm), completion ratio (%) and the accuracy of the last frame (cm); ignore the map.

        The original prints the accuracy of the last frame alone: its points are on the mesh, so the number is the
        distance between samples. Raise `InputError` without a path.
        """
        if path is None:
            raise InputError(f"protocol '{self.name}' draws the frames of a run, and needs their poses: give --poses")
        nearest = np.minimum(streamed_distances(truth.points, self.seen(truth.scene, path)), self.farthest_m)
        (last,) = self.seen(truth.scene, dataclasses.replace(path, frames=path.all_poses[-1:]))
        accuracy = 100.0 * float(nearest_distances(last, truth.points).mean()) if len(last) else None
        return {
            "accuracy_cm": accuracy,
            "completion_cm": 100.0 * float(nearest.mean()),
            "completion_ratio": 100.0 * float(np.mean(nearest < self.threshold_m)),
            "true_samples": len(truth.points),
            "notes": {} if len(last) else {"accuracy_cm": "the last frame saw nothing"},
        }

    def seen(self, scene: Scene, path: CameraPath) -> Iterator[np.ndarray]:  # [n, 3] metres each
        """Yield the points that each frame of the path saw, one per pixel with a surface within `range_m`."""
        height = max(1, round(self.image_width * path.camera.height / path.camera.width))
        rays = path.camera.resized(self.image_width, height).rays().reshape(-1, 3)
        for pose in path.all_poses:
            depth = scene.raycaster.cast(pose[:3, 3], rays @ pose[:3, :3].T).distance.astype(np.float64)
            hit = depth <= self.range_m
            yield transform_points(pose, rays[hit] * depth[hit, None])
