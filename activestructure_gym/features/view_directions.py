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
REACH = 5.0  # metres of measured depth; keyframes count up to it in ActiveGS's `nearness` and `concentration`
_SLACK_M = 0.05  # metres behind a surface up to which a point is visible; most interior walls are thicker
_WITHIN_A_PIXEL = 1.05  # limit of a neighbour's depth relative to the pixel's own; what is deeper is another surface
_CELLS = 64  # number of cells per side of the table that maps a direction to its bin
# Columns of the kernel's sums: count, sum of v, sum of products v v^T, and for both sides nearness, count and sum of v.
_V, _PRODUCTS, _SIDES = slice(1, 4), slice(4, 10), slice(10, 20)


@dataclass(frozen=True)
class ViewDirections:
    """Hold statistics of the keyframes that see each of N Gaussians.

    v is the unit vector from the Gaussian to the camera of such a keyframe, in the world frame.
    """

    count: np.ndarray  # [N] int32, number of keyframes that see it
    nearness: np.ndarray  # [N] float64, sum of max(0, 1 - distance / 5 m) n v over the keyframes that face the front
    # [N] float64 0..1, length of the mean v over the keyframes that face the front; 1 if all directions are equal
    concentration: np.ndarray
    normals: np.ndarray  # [N, 3] unit, world: n, of the front; 0 for isotropic Gaussians and if no keyframe faces it
    bins: np.ndarray  # [N, 2] uint64, bit set: bit b is 1 if a v is nearest to `fibonacci_directions(DIRECTIONS)[b]`
    sum: np.ndarray  # [N, 3] sum of v
    products: np.ndarray  # [N, 6] sum of v v^T, upper triangle row by row
    keyframes: int  # number of all keyframes


def view_directions(mapper: KeyframeMapper) -> ViewDirections:
    """Return the `ViewDirections` of all Gaussians and keyframes.

    A keyframe sees a Gaussian if its mean projects into the image and is not hidden by the surface measured there
    (`is_hidden`). The keyframe faces the front if n v > 0 and the depth of the pixel is below 5 m. The front is the
    side with the larger nearness. Isotropic Gaussians have no normal; n v is 1 for them.
    """
    gaussians, isotropic = mapper.map, mapper.isotropic
    count = gaussians.count
    axes = np.zeros((count, 3)) if isotropic else shortest_axes(gaussians)
    boxes = block_boxes(gaussians.parameters, count)
    sums, bins = np.zeros((count, 20)), np.zeros((count, 2), np.uint64)
    for frame in mapper.keyframes:
        camera = frame.camera
        seen = may_be_seen(boxes, camera, frame.world_from_camera)
        eye = frame.world_from_camera[:3, 3].astype(np.float64)
        view = _View(invert_rigid(frame.world_from_camera), eye, camera.lens, frame.depth)
        _add_view(_Gaussians(gaussians.parameters, count, axes, isotropic), seen, view, bin_table(), sums, bins)
    sides = sums[:, _SIDES].reshape(count, 2, 5)
    back = sides[:, 1, 0] > sides[:, 0, 0]
    front = np.where(back[:, None], sides[:, 1], sides[:, 0])
    facing = np.maximum(front[:, 1], 1.0)
    return ViewDirections(
        count=sums[:, 0].astype(np.int32),
        nearness=front[:, 0],
        concentration=np.linalg.norm(front[:, 2:], axis=1) / facing,
        normals=np.where(back[:, None], -axes, axes) * (front[:, 1:2] > 0),
        bins=bins,
        sum=sums[:, _V],
        products=sums[:, _PRODUCTS],
        keyframes=len(mapper.keyframes),
    )


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
def is_hidden(deep: float, depth: np.ndarray, row: int, column: int) -> bool:
    """Return whether a point at the depth ``deep`` in a pixel is more than 5 cm behind the surface in ``depth`` [H, W].

    The deepest of the pixel and its neighbours counts, since on slanted surface the depth changes within a pixel, but
    at most 1.05 times the depth of the pixel itself. Infinite depths of neighbours show no surface.
    """
    own = farthest = depth[row, column]
    if deep <= own + _SLACK_M:
        return False
    for beside in range(max(0, row - 1), min(depth.shape[0], row + 2)):
        for at in range(max(0, column - 1), min(depth.shape[1], column + 2)):
            if depth[beside, at] < np.inf:
                farthest = max(farthest, depth[beside, at])
    return bool(deep > min(farthest, _WITHIN_A_PIXEL * own) + _SLACK_M)


@kernel
def _add_view(
    gaussians: _Gaussians,
    seen: np.ndarray,  # [blocks] bool: blocks of Gaussians that can be in the image
    view: _View,
    table: np.ndarray,  # [cells, cells] int64, see `bin_table`
    sums: np.ndarray,  # [N, 20] in place, columns as in `_SIDES`
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
            row, column = int(v), int(u)
            measured = depth[row, column]
            if measured <= 0.0:
                continue
            if is_hidden(deep, depth, row, column):
                continue
            x, y, z = eye[0] - x, eye[1] - y, eye[2] - z
            distance = np.sqrt(x * x + y * y + z * z)
            x, y, z = x / distance, y / distance, z / distance
            sums[i, 0] += 1.0
            sums[i, 1] += x
            sums[i, 2] += y
            sums[i, 3] += z
            sums[i, 4] += x * x
            sums[i, 5] += x * y
            sums[i, 6] += x * z
            sums[i, 7] += y * y
            sums[i, 8] += y * z
            sums[i, 9] += z * z
            cosine = 1.0 if isotropic else x * normals[i, 0] + y * normals[i, 1] + z * normals[i, 2]
            if measured < REACH and cosine != 0.0:
                side = 10 if cosine > 0.0 else 15
                sums[i, side] += max(0.0, 1.0 - distance / REACH) * abs(cosine)
                sums[i, side + 1] += 1.0
                sums[i, side + 2] += x
                sums[i, side + 3] += y
                sums[i, side + 4] += z
            total = abs(x) + abs(y) + abs(z)
            a, b = x / total, y / total
            if z < 0.0:
                a, b = (1.0 - abs(b)) * (1.0 if a >= 0.0 else -1.0), (1.0 - abs(a)) * (1.0 if b >= 0.0 else -1.0)
            row = min(cells - 1, int((a + 1.0) * 0.5 * cells))
            column = min(cells - 1, int((b + 1.0) * 0.5 * cells))
            direction = table[row, column]
            bins[i, direction >> 6] |= np.uint64(1) << np.uint64(direction & 63)
