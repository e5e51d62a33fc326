"""Define the protocol ``naruto``, which reproduces the evaluation of [naruto, code] and of Co-SLAM before it.

The surface of the map is culled to what its frames can see of it, and compared with the mesh.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.metrics.geometry import nearest_distances
from activestructure_gym.evaluation.protocols.activesplat import SampledTruth, sampled_truth
from activestructure_gym.evaluation.protocols.base import CameraPath
from activestructure_gym.evaluation.protocols.standard import StandardProtocol
from activestructure_gym.geometry import invert_rigid
from activestructure_gym.ranges import check_ranges

if TYPE_CHECKING:
    from activestructure_gym.ground_truth import GroundTruth
    from activestructure_gym.mapping import GaussianMap

_RANGES = {
    "samples": "[1, 5000000]",
    "threshold_m": "(0, 1000]",
    "every": "[1, 1000]",
    "behind_m": "[0, 10]",
    "farthest_m": "(0, 1000]",
    **dict.fromkeys(("voxel_m", "truncation_m"), "[0.001, 100]"),
    "image_width": "[16, 4096]",
}


@dataclass(frozen=True)
class NarutoProtocol:
    """Compare samples on the surface of the map, culled to what the frames see, with samples on the mesh.

    The original extracts a mesh from its neural field. Here the surface is that of protocol ``standard``: the depth of
    the map at the keyframes, fused into a TSDF.

    Parameters
    ----------
    samples
        Samples on the surface of the map, and as many on the whole mesh.
    scanned
        Whether samples of the mesh that a scanner would not see are left out, as in `ActiveSplatProtocol`.
    threshold_m
        Metres. The completion ratio and the precision count distances strictly below it.
    every
        The culling uses one of this many frames.
    behind_m, farthest_m
        Metres. A corner of a triangle is kept if a frame sees it within ``farthest_m``, at most ``behind_m`` behind the
        nearest surface of the map in its pixel.
    voxel_m, truncation_m, image_width
        Constants of the TSDF surface, as in `StandardProtocol`; the culling has images of the same width.
    """

    name: ClassVar[str] = "naruto"
    version: ClassVar[int] = 1  # increase it when the same map would get other numbers

    samples: int = 200_000
    scanned: bool = True
    threshold_m: float = 0.05
    every: int = 2
    behind_m: float = 0.03
    farthest_m: float = 10.0
    voxel_m: float = 0.02
    truncation_m: float = 0.06
    image_width: int = 320

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES)

    def parameters(self) -> dict[str, Any]:
        """Return name, version and all constants for the result file."""
        return {"name": self.name, "version": self.version, **dataclasses.asdict(self)}

    def truth(self, known: GroundTruth) -> SampledTruth:
        """Return samples on the surface of the scene (`sampled_truth`)."""
        return sampled_truth(known, self.samples, scanned=self.scanned)

    def evaluate(self, gaussians: GaussianMap, truth: SampledTruth, path: CameraPath | None = None) -> dict[str, Any]:
        """Return accuracy (cm), completion (cm), completion ratio (%) and precision (%) of the culled surface.

        The program of [naruto, code] passes its two meshes in the other order than the function expects. So it prints
        the completion as accuracy, the accuracy as completion, and the precision as completion ratio. Raise
        `InputError` without a path.
        """
        if path is None:
            raise InputError(f"protocol '{self.name}' fuses the map at the poses of a run: give --poses")
        from activestructure_gym.ground_truth.surface_samples import samples_by_area

        triangles = self.culled(self.surface(gaussians, path), path)
        area = 0.5 * np.linalg.norm(
            np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
        )
        if not area.sum() > 0.0:
            nothing = dict.fromkeys(("accuracy_cm", "completion_cm", "precision"))
            return nothing | {
                "completion_ratio": 0.0, "area_m2": 0.0, "notes": {"naruto": "the map has no surface in sight"}
            }  # fmt: skip
        points, _, total = samples_by_area(triangles, area, self.samples, np.random.default_rng(0))
        to_true, from_true = nearest_distances(points, truth.points), nearest_distances(truth.points, points)
        return {
            "accuracy_cm": 100.0 * float(to_true.mean()),
            "completion_cm": 100.0 * float(from_true.mean()),
            "completion_ratio": 100.0 * float(np.mean(from_true < self.threshold_m)),
            "precision": 100.0 * float(np.mean(to_true < self.threshold_m)),
            "area_m2": total,
            "notes": {},
        }

    def surface(self, gaussians: GaussianMap, path: CameraPath) -> np.ndarray:  # [T, 3, 3] metres
        """Return the corners of the triangles of the map's surface; raise `InputError` if it is too large."""
        fused = StandardProtocol(
            tsdf_voxel_m=self.voxel_m, tsdf_truncation_m=self.truncation_m, tsdf_image_width=self.image_width
        ).surface(gaussians, path)
        pieces = list(fused.pieces())
        return np.concatenate(pieces).astype(np.float64) if pieces else np.zeros((0, 3, 3))

    def culled(self, triangles: np.ndarray, path: CameraPath) -> np.ndarray:  # [T, 3, 3] -> [t, 3, 3] metres
        """Return the triangles of which a frame sees a corner: in the image, and not behind other triangles."""
        if not len(triangles):
            return triangles
        from activestructure_gym.scenes.raycaster import RayCaster

        corners, faces = _merged(triangles)
        caster = RayCaster(corners, faces)
        height = max(1, round(self.image_width * path.camera.height / path.camera.width))
        camera = path.camera.resized(self.image_width, height)
        rays = camera.rays().reshape(-1, 3)
        intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        unseen = np.arange(len(corners))
        for pose in path.all_poses[:: self.every]:
            pixels, ahead = np.empty(len(unseen), np.int64), np.empty(len(unseen))
            _project(corners, unseen, invert_rigid(pose), intrinsics, height, self.image_width, pixels, ahead)
            needed, depth = np.zeros(len(rays), bool), np.zeros(len(rays))
            needed[pixels[pixels >= 0]] = True
            depth[needed] = caster.cast(pose[:3, 3], rays[needed] @ pose[:3, :3].T).distance
            depth[depth > self.farthest_m] = 0.0
            unseen = unseen[(pixels < 0) | (ahead >= depth[pixels] + self.behind_m)]
        seen = np.ones(len(corners), bool)
        seen[unseen] = False
        return triangles[seen[faces].any(axis=1)]


def _merged(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # [T, 3, 3] -> [V, 3], [T, 3] int64
    """Return the distinct corners of triangles in the order of their first use, and their rows for each triangle."""
    corners = np.ascontiguousarray(triangles, np.float64).reshape(-1, 3)
    first, rows = np.empty(len(corners), np.int64), np.empty(len(corners), np.int64)
    table = np.full(1 << len(corners).bit_length(), -1, np.int32)
    count = _number((corners + 0.0).view(np.int64), table, first, rows)  # + 0.0: -0.0 is 0.0
    return corners[first[:count]], rows.reshape(-1, 3)


_ODD = 0x1E3779B97F4A7C15  # multiplying by it spreads bits upwards


@kernel
def _number(
    bits: np.ndarray,  # [n, 3] int64, coordinates as integers
    table: np.ndarray,  # [2 ** k] int32, k > log2(n): the row of a distinct point, -1 = free
    first: np.ndarray,  # [n] int64 out: the first point of each row
    rows: np.ndarray,  # [n] int64 out: the row of each point
) -> int:
    """Give equal points one row, found with a hash table, and return the number of rows."""
    count, last = 0, len(table) - 1
    for n in range(len(bits)):
        mixed = ((bits[n, 0] * _ODD ^ bits[n, 1]) * _ODD ^ bits[n, 2]) * _ODD
        slot = (mixed >> 32) & last  # the low bits of coordinates are often 0, and so are those of the product
        while table[slot] >= 0:
            own = bits[first[table[slot]]]
            if own[0] == bits[n, 0] and own[1] == bits[n, 1] and own[2] == bits[n, 2]:
                break
            slot = (slot + 1) & last
        if table[slot] < 0:
            table[slot], first[count] = count, n
            count += 1
        rows[n] = table[slot]
    return count


@kernel
def _project(
    points: np.ndarray,  # [V, 3] metres
    rows: np.ndarray,  # [n] int64, the points to project
    camera_from_world: np.ndarray,  # [4, 4]
    intrinsics: np.ndarray,  # [4] fx, fy, cx, cy in pixels
    height: int,
    width: int,
    pixels: np.ndarray,  # [n] int64 out: row * width + column, -1 outside of the image
    depths: np.ndarray,  # [n] metres out
) -> None:
    """Write the pixel of each point and its depth."""
    m = camera_from_world
    for n in range(len(rows)):
        x, y, z = points[rows[n]]
        ahead = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        depths[n], pixels[n] = ahead, -1
        if ahead <= 0.0:
            continue
        u = intrinsics[0] * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / ahead + intrinsics[2]
        v = intrinsics[1] * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / ahead + intrinsics[3]
        if u >= 0.0 and v >= 0.0 and u < width and v < height:
            pixels[n] = int(v) * width + int(u)
