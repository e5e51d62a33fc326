"""From which directions the keyframes have seen each Gaussian, computed from their depth images on request.

Nothing is stored: the same map and keyframes give the same numbers, however Gaussians came, moved and went. The cost
grows with keyframes times Gaussians in view: a few milliseconds for a hundred keyframes and 30,000 Gaussians.
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

DIRECTIONS = 128  # bins of the sphere, two words of bits per Gaussian (COVER takes as many)
REACH = 5.0  # metres, beyond which a look is worth nothing (ActiveGS)
_SLACK_M = 0.05  # a Gaussian this far behind the measured surface still counts as seen ...
_SLACK_SHARE = 0.05  # ... and this share of the depth more
_CELLS = 64  # of each side of the table that finds the bin of a direction


@dataclass(frozen=True)
class Sightings:
    """The keyframes that N Gaussians were seen from, summed up; v is the unit direction from a Gaussian to a camera."""

    count: np.ndarray  # [N] int32 keyframes that saw it
    nearness: np.ndarray  # [N] float64, sum of (1 - distance / 5 m) max(0, n v), n its normal on the side seen more
    concentration: np.ndarray  # [N] float64 0..1, length of the mean v: 1 where all looks came from one direction
    bins: np.ndarray  # [N, 2] uint64, the bins of `fibonacci_directions(DIRECTIONS)` that v fell into
    sum: np.ndarray  # [N, 3] of v
    products: np.ndarray  # [N, 6] sum of v v^T, upper triangle row by row
    keyframes: int  # that there are


def sightings(mapper: KeyframeMapper) -> Sightings:
    """`Sightings` of all Gaussians by all keyframes. Balls have no normal: n v counts as 1.

    A keyframe sees a Gaussian whose mean projects into its image and does not lie behind the surface measured there.
    """
    gaussians, isotropic = mapper.map, mapper.isotropic
    count = gaussians.count
    normals = np.zeros((count, 3)) if isotropic else shortest_axes(gaussians)
    boxes = block_boxes(gaussians.parameters, count)
    looks, bins = np.zeros((count, 12)), np.zeros((count, 2), np.uint64)
    for frame in mapper.keyframes:
        camera = frame.camera
        seen = may_be_seen(boxes, camera, frame.world_from_camera)
        eye = frame.world_from_camera[:3, 3].astype(np.float64)
        view = _View(invert_rigid(frame.world_from_camera), eye, camera.lens, frame.depth)
        _look(_Gaussians(gaussians.parameters, count, normals, isotropic), seen, view, bin_table(), looks, bins)
    number = looks[:, 0]
    length = np.linalg.norm(looks[:, 3:6], axis=1) / np.maximum(number, 1.0)
    nearness, keyframes = looks[:, 1:3].max(axis=1), len(mapper.keyframes)
    return Sightings(number.astype(np.int32), nearness, length, bins, looks[:, 3:6], looks[:, 6:], keyframes)


def shortest_axes(gaussians: GaussianMap) -> np.ndarray:  # [N, 3] unit, world
    """The axis along which each Gaussian is thinnest; its sign means nothing."""
    live = gaussians.parameters[:, : gaussians.count].astype(np.float64)
    w, x, y, z = live[QUATERNION] / np.maximum(np.linalg.norm(live[QUATERNION], axis=0), 1e-30)
    rotations = np.array(matrix_rows(w, x, y, z))  # [world, axis, N]
    return np.ascontiguousarray(rotations[:, live[LOG_SCALE].argmin(axis=0), np.arange(gaussians.count)].T)


@lru_cache(1)
def bin_table() -> np.ndarray:  # [_CELLS, _CELLS] int64
    """The bin of every cell of the sphere folded onto a square (octahedral map); exact at the cells' middles."""
    middle = (np.arange(_CELLS) + 0.5) / _CELLS * 2.0 - 1.0
    x, y = np.meshgrid(middle, middle, indexing="ij")
    z = 1.0 - np.abs(x) - np.abs(y)
    folded_x, folded_y = (1.0 - np.abs(y)) * np.sign(x), (1.0 - np.abs(x)) * np.sign(y)
    points = np.stack([np.where(z < 0, folded_x, x), np.where(z < 0, folded_y, y), z], axis=-1)
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    return np.ascontiguousarray((points @ fibonacci_directions(DIRECTIONS).T).argmax(axis=-1))


class _Gaussians(NamedTuple):
    parameters: np.ndarray  # [14, capacity] float32
    live: int  # how many columns count
    normals: np.ndarray  # [N, 3]
    isotropic: bool


class _View(NamedTuple):
    pose: np.ndarray  # [4, 4] camera_from_world
    eye: np.ndarray  # [3] metres
    lens: Lens
    depth: np.ndarray  # [h, w] float32 metres, 0 = no return


@kernel
def _look(
    gaussians: _Gaussians,
    seen: np.ndarray,  # [blocks] bool
    view: _View,
    table: np.ndarray,  # [cells, cells] int64
    looks: np.ndarray,  # [N, 12] added to: 1, nearness in front, behind, v, products of v
    bins: np.ndarray,  # [N, 2] uint64, added to
) -> None:
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
            looks[i, 0] += 1.0
            looks[i, 1] += near * max(0.0, cosine)
            looks[i, 2] += near * max(0.0, -cosine)
            looks[i, 3] += x
            looks[i, 4] += y
            looks[i, 5] += z
            looks[i, 6] += x * x
            looks[i, 7] += x * y
            looks[i, 8] += x * z
            looks[i, 9] += y * y
            looks[i, 10] += y * z
            looks[i, 11] += z * z
            total = abs(x) + abs(y) + abs(z)
            a, b = x / total, y / total
            if z < 0.0:
                a, b = (1.0 - abs(b)) * (1.0 if a >= 0.0 else -1.0), (1.0 - abs(a)) * (1.0 if b >= 0.0 else -1.0)
            row = min(cells - 1, int((a + 1.0) * 0.5 * cells))
            column = min(cells - 1, int((b + 1.0) * 0.5 * cells))
            direction = table[row, column]
            bins[i, direction >> 6] |= np.uint64(1) << np.uint64(direction & 63)
