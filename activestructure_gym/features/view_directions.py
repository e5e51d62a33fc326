"""Compute from which directions the keyframes have seen each Gaussian, with their depth images as occlusion test.

Nothing is stored: the result depends on the current map and keyframes only. The cost is proportional to the number of
keyframes times the number of Gaussians in view: a few milliseconds for 100 keyframes and 30,000 Gaussians.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry import fibonacci_directions, invert_rigid
from activestructure_gym.geometry.camera import Lens
from activestructure_gym.geometry.rotations import matrix_rows
from activestructure_gym.mapping import KeyframeMapper
from activestructure_gym.mapping.boxes import BLOCK, block_boxes
from activestructure_gym.mapping.frustum_culling import may_be_seen
from activestructure_gym.mapping.gaussian_map import LOG_SCALE, QUATERNION, GaussianMap

DIRECTIONS = 128  # number of direction bins of the sphere, stored in 2 x 64 bits per Gaussian (as in COVER)
REACH = 5.0  # metres; a keyframe from farther away adds nothing to `ViewDirections.nearness` (ActiveGS)
# A Gaussian is seen if it is at most _SLACK_M (metres) plus _SLACK_SHARE of the depth behind the measured surface.
_SLACK_M = 0.05
_SLACK_SHARE = 0.05
_CELLS = 64  # number of cells per side of the table that maps a direction to its bin


@dataclass(frozen=True)
class ViewDirections:
    """Hold statistics of the keyframes that see each of N Gaussians.

    v is the unit vector from the Gaussian to the camera of such a keyframe, in the world frame.
    """

    count: np.ndarray  # [N] int32, number of keyframes that see it
    # [N] float64, sum of max(0, 1 - distance / 5 m) max(0, n v). n is the normal of the side with the larger sum.
    nearness: np.ndarray
    concentration: np.ndarray  # [N] float64 0..1, length of the mean v; 1 if all directions are equal
    bins: np.ndarray  # [N, 2] uint64, bit set: bit b is 1 if a v is nearest to `fibonacci_directions(DIRECTIONS)[b]`
    sum: np.ndarray  # [N, 3] sum of v
    products: np.ndarray  # [N, 6] sum of v v^T, upper triangle row by row
    keyframes: int  # number of all keyframes


def view_directions(mapper: KeyframeMapper) -> ViewDirections:
    """Return the `ViewDirections` of all Gaussians and keyframes.

    A keyframe sees a Gaussian if its mean projects into the image and is not behind the surface measured there.
    Isotropic Gaussians have no normal; n v is 1 for them.
    """
    gaussians, isotropic = mapper.map, mapper.isotropic
    count = gaussians.count
    normals = np.zeros((count, 3)) if isotropic else shortest_axes(gaussians)
    boxes = block_boxes(gaussians.parameters, count)
    sums, bins = np.zeros((count, 12)), np.zeros((count, 2), np.uint64)
    for frame in mapper.keyframes:
        camera = frame.camera
        seen = may_be_seen(boxes, camera, frame.world_from_camera)
        eye = frame.world_from_camera[:3, 3].astype(np.float64)
        view = _View(invert_rigid(frame.world_from_camera), eye, camera.lens, frame.depth)
        _add_view(_Gaussians(gaussians.parameters, count, normals, isotropic), seen, view, bin_table(), sums, bins)
    number = sums[:, 0]
    length = np.linalg.norm(sums[:, 3:6], axis=1) / np.maximum(number, 1.0)
    nearness, keyframes = sums[:, 1:3].max(axis=1), len(mapper.keyframes)
    return ViewDirections(number.astype(np.int32), nearness, length, bins, sums[:, 3:6], sums[:, 6:], keyframes)


def shortest_axes(gaussians: GaussianMap) -> np.ndarray:  # [N, 3] unit, world
    """Return the direction in which each Gaussian has its smallest scale; the sign of the vector is arbitrary."""
    used = gaussians.parameters[:, : gaussians.count].astype(np.float64)
    w, x, y, z = used[QUATERNION] / np.maximum(np.linalg.norm(used[QUATERNION], axis=0), 1e-30)
    rotations = np.array(matrix_rows(w, x, y, z))  # [world, axis, N]
    return np.ascontiguousarray(rotations[:, used[LOG_SCALE].argmin(axis=0), np.arange(gaussians.count)].T)


@lru_cache(1)
def bin_table() -> np.ndarray:  # [_CELLS, _CELLS] int64
    """Return the nearest of the 128 Fibonacci directions for every cell of the octahedral map of the sphere.

    The octahedral map unfolds the sphere to a square of 64 x 64 cells. The result is exact at the centre of a cell.
    """
    middle = (np.arange(_CELLS) + 0.5) / _CELLS * 2.0 - 1.0
    x, y = np.meshgrid(middle, middle, indexing="ij")
    z = 1.0 - np.abs(x) - np.abs(y)
    folded_x, folded_y = (1.0 - np.abs(y)) * np.sign(x), (1.0 - np.abs(x)) * np.sign(y)
    points = np.stack([np.where(z < 0, folded_x, x), np.where(z < 0, folded_y, y), z], axis=-1)
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    return np.ascontiguousarray((points @ fibonacci_directions(DIRECTIONS).T).argmax(axis=-1))


class _Gaussians(NamedTuple):
    parameters: np.ndarray  # [14, capacity] float32
    count: int  # type: ignore[assignment]  # columns in use
    normals: np.ndarray  # [N, 3] unit, world
    isotropic: bool


class _View(NamedTuple):
    pose: np.ndarray  # [4, 4] camera_from_world
    eye: np.ndarray  # [3] metres, world: camera position
    lens: Lens
    depth: np.ndarray  # [h, w] float32 metres, 0 = no return


@kernel
def _add_view(
    gaussians: _Gaussians,
    seen: np.ndarray,  # [blocks] bool: blocks of Gaussians that can be in the image
    view: _View,
    table: np.ndarray,  # [cells, cells] int64, see `bin_table`
    sums: np.ndarray,  # [N, 12] in place: count, nearness on the side of n, on the other side, sum of v, of products
    bins: np.ndarray,  # [N, 2] uint64, in place
) -> None:
    """Add one keyframe to the statistics of the Gaussians that it sees."""
    parameters, count, normals, isotropic = gaussians
    pose, eye, lens, depth = view
    height, width = depth.shape
    cells = len(table)
    for block in range(len(seen)):
        if not seen[block]:
            continue
        for i in range(block * BLOCK, min(count, (block + 1) * BLOCK)):
            x, y, z = float(parameters[0, i]), float(parameters[1, i]), float(parameters[2, i])
            deep = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
            if not deep > 0.0:
                continue
            u = lens[0] * (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) / deep + lens[2]
            v = lens[1] * (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) / deep + lens[3]
            if not (0.0 <= u < width and 0.0 <= v < height):
                continue
            measured = depth[int(v), int(u)]
            if not 0.0 < deep <= measured * (1.0 + _SLACK_SHARE) + _SLACK_M or measured <= 0.0:
                continue
            x, y, z = eye[0] - x, eye[1] - y, eye[2] - z
            distance = np.sqrt(x * x + y * y + z * z)
            x, y, z = x / distance, y / distance, z / distance
            near = max(0.0, 1.0 - distance / REACH)
            cosine = 1.0 if isotropic else x * normals[i, 0] + y * normals[i, 1] + z * normals[i, 2]
            sums[i, 0] += 1.0
            sums[i, 1] += near * max(0.0, cosine)
            sums[i, 2] += near * max(0.0, -cosine)
            sums[i, 3] += x
            sums[i, 4] += y
            sums[i, 5] += z
            sums[i, 6] += x * x
            sums[i, 7] += x * y
            sums[i, 8] += x * z
            sums[i, 9] += y * y
            sums[i, 10] += y * z
            sums[i, 11] += z * z
            total = abs(x) + abs(y) + abs(z)
            a, b = x / total, y / total
            if z < 0.0:
                a, b = (1.0 - abs(b)) * (1.0 if a >= 0.0 else -1.0), (1.0 - abs(a)) * (1.0 if b >= 0.0 else -1.0)
            row = min(cells - 1, int((a + 1.0) * 0.5 * cells))
            column = min(cells - 1, int((b + 1.0) * 0.5 * cells))
            direction = table[row, column]
            bins[i, direction >> 6] |= np.uint64(1) << np.uint64(direction & 63)
