"""Integrate a depth image into the voxel grid in one pass: hits, conservative carving of free space, projective TSDF.

A hit is a ray that ends in a voxel. Carving marks voxels that rays passed through as free. These rules make the free
space safe to move in:

- A voxel is carved only if every ray through its projected footprint, and one ring of rays around it, ends behind the
  far side of the voxel by more than the sensor's noise. A ray without return proves nothing.
- A voxel in which any ray ends is occupied, however thin the structure is.
- A voxel at the border of the image is seen in part. Its 4 x 4 x 4 parts, proven free by different views or by the
  agent's body, are combined. Otherwise the seam between two views would remain unknown and block the agent.
- Rays are samples: at depth z they are z / f apart, with focal length f in pixels. A structure of width w can be
  between
  them. One view misses it with probability 1 - min(1, w f / z). A voxel is free only when the product of these
  probabilities over all views is small.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.camera import Lens
from activestructure_gym.volume.depth_image import READS_PER_SIDE

UNKNOWN = 0
FREE = 1
OCCUPIED = 2

# Metres. Below this depth the footprint of a voxel exceeds the image; the limit also avoids projection at z = 0.
_MIN_DEPTH_M = 0.05
PARTS_PER_SIDE = 4  # parts of a voxel along each axis
ALL_PARTS = np.uint64(2**64 - 1)  # bit mask with the bits of all 64 parts
_ONE = np.uint64(1)
# A smaller miss probability is rounded to 0; the voxel then needs no more views.
_SURE = 1e-3


class VoxelFields(NamedTuple):
    """Hold the arrays of the volume, each [X, Y, Z], as one kernel argument."""

    origin: np.ndarray  # [3] metres, lower corner of voxel (0, 0, 0)
    voxel_size: float  # metres
    state: np.ndarray  # uint8: UNKNOWN, FREE or OCCUPIED
    solidity: np.ndarray  # int16 hit counter; the voxel is occupied while it is above 0
    miss_chance: np.ndarray  # float32 probability that a thin structure was missed by all views
    parts: np.ndarray  # uint64: one bit for each of the 64 parts of a voxel that is proven free
    last_hit: np.ndarray  # int32: number of the last image with a hit in the voxel
    tsdf: np.ndarray  # float32 signed distance / truncation distance
    weight: np.ndarray  # float32 number of observations of the TSDF, limited


class Look(NamedTuple):
    """Hold a depth image in the form that `carve` needs."""

    number: int  # number of the image
    fresh: bool  # whether the pose differs from that of the previous image
    depth: np.ndarray  # [H, W] float32 measured depth, metres
    pyramid: np.ndarray  # free distance of the rays, see `minimum_pyramid`
    levels: np.ndarray  # levels of the pyramid, see `minimum_pyramid`
    lens: Lens
    camera_from_world: np.ndarray  # [4, 4]


class Frustum(NamedTuple):
    """Hold the result of `frustum_planes`, and the box [lower, upper) of voxels that the view frustum can touch."""

    planes: np.ndarray  # [6, 4]
    reach: np.ndarray  # [6]
    sides: np.ndarray  # [64, 4]
    extents: np.ndarray  # [3]
    lower: np.ndarray  # [3] int64
    upper: np.ndarray  # [3] int64


class Caution(NamedTuple):
    """Hold the margins and thresholds of `carve`, explained at `VolumeConfig`."""

    margin: float  # metres
    margin_growth: float  # metres per square metre of depth
    thinnest: float  # metres, width of the thinnest structure that rays must not miss
    max_miss_chance: float
    truncation: float  # metres
    max_weight: float


@kernel
def mark_hits(
    depth: np.ndarray,  # [H, W] float32
    lens: Lens,
    world_from_camera: np.ndarray,  # [4, 4]
    voxels: VoxelFields,
    max_range: float,  # metres; larger depths are ignored
    image_number: int,  # number of this image
    gain: int,  # increase of the hit counter by a hit
    ceiling: int,  # largest value of the hit counter
) -> None:
    """Mark each voxel in which a returning ray ends as occupied, at most once per image."""
    fx, fy, cx, cy = lens
    origin, voxel_size, state, solidity, miss_chance, parts, last_hit, _, _ = voxels
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            z = depth[v, u]
            if not 0.0 < z <= max_range:
                continue
            x = (u + 0.5 - cx) / fx * z
            y = (v + 0.5 - cy) / fy * z
            i = int(np.floor((world_from_camera[0, 0] * x + world_from_camera[0, 1] * y + world_from_camera[0, 2] * z
                              + world_from_camera[0, 3] - origin[0]) / voxel_size))  # fmt: skip
            j = int(np.floor((world_from_camera[1, 0] * x + world_from_camera[1, 1] * y + world_from_camera[1, 2] * z
                              + world_from_camera[1, 3] - origin[1]) / voxel_size))  # fmt: skip
            k = int(np.floor((world_from_camera[2, 0] * x + world_from_camera[2, 1] * y + world_from_camera[2, 2] * z
                              + world_from_camera[2, 3] - origin[2]) / voxel_size))  # fmt: skip
            if not (0 <= i < state.shape[0] and 0 <= j < state.shape[1] and 0 <= k < state.shape[2]):
                continue
            if last_hit[i, j, k] != image_number:
                last_hit[i, j, k] = image_number
                solidity[i, j, k] = min(solidity[i, j, k] + gain, ceiling)
                miss_chance[i, j, k] = 1.0
                parts[i, j, k] = 0
                state[i, j, k] = OCCUPIED


@kernel
def _nearest_in_footprint(
    pyramid: np.ndarray, levels: np.ndarray, u0: int, u1: int, v0: int, v1: int, enough: float
) -> np.floating:
    """Return the smallest free distance of the pixels in columns u0..u1 and rows v0..v1, or of slightly more pixels.

    The search ends at a distance of at most ``enough``. ``pyramid`` and ``levels`` are from `minimum_pyramid`.
    """
    level = 0
    while level + 1 < len(levels) and max(u1 - u0, v1 - v0) >> level > READS_PER_SIDE:
        level += 1
    start, width = levels[level, 0], levels[level, 2]
    smallest = np.float32(np.inf)
    for v in range(v0 >> level, (v1 >> level) + 1):
        row = start + v * width
        for u in range(u0 >> level, (u1 >> level) + 1):
            smallest = min(smallest, pyramid[row + u])
            if smallest <= enough:
                return smallest
    return smallest


@kernel
def values_at(
    points: np.ndarray,  # [N, 3] metres, world
    origin: np.ndarray,  # [3] metres, lower corner of voxel (0, 0, 0)
    voxel_size: float,  # metres
    values: np.ndarray,  # [X, Y, Z]
    outside: float,  # value of points outside the grid
) -> np.ndarray:  # [N] of the type of ``values``
    """Return the value of the voxel that contains each point."""
    found = np.empty(len(points), values.dtype)
    for n in range(len(points)):
        x = np.floor((points[n, 0] - origin[0]) / voxel_size)
        y = np.floor((points[n, 1] - origin[1]) / voxel_size)
        z = np.floor((points[n, 2] - origin[2]) / voxel_size)
        if 0 <= x < values.shape[0] and 0 <= y < values.shape[1] and 0 <= z < values.shape[2]:
            found[n] = values[int(x), int(y), int(z)]
        else:
            found[n] = outside
    return found


def frustum_planes(
    camera: PinholeCamera,
    camera_from_world: np.ndarray,  # [4, 4]
    voxel_size: float,  # metres
    max_range: float,  # metres
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the view frustum of the outermost rays, and the extents of a voxel along the normals of its planes.

    Returns four arrays, in the camera frame:

    - the inequalities a . p >= b as rows [6, 4]: left, right, top, bottom, near, far;
    - half the extent of a voxel along each normal [6];
    - for each of the 64 parts of a voxel, the minimum of the first four a . p relative to the voxel's centre [64, 4];
    - half the extents of a voxel along the camera's axes [3].
    """
    planes = _sides_of_view(camera, max_range)
    rotation = camera_from_world[:3, :3]
    normals = planes[:, :3] @ rotation  # [6, 3] along the world's axes
    reach = 0.5 * voxel_size * np.abs(normals).sum(axis=1)
    sides = voxel_size * part_centers() @ normals[:4].T - reach[:4] / PARTS_PER_SIDE
    return planes, reach, sides, 0.5 * voxel_size * np.abs(rotation).sum(axis=1)


@cache
def _sides_of_view(camera: PinholeCamera, max_range: float) -> np.ndarray:  # [6, 4], not to be changed
    c = camera  # the array stays writable, because numba would compile `carve` again for a read-only one
    planes = np.array([
        [c.fx, 0.0, c.cx - 0.5, 0.0], [-c.fx, 0.0, c.width - 0.5 - c.cx, 0.0],
        [0.0, c.fy, c.cy - 0.5, 0.0], [0.0, -c.fy, c.height - 0.5 - c.cy, 0.0],
        [0.0, 0.0, 1.0, _MIN_DEPTH_M], [0.0, 0.0, -1.0, -max_range],
    ])  # fmt: skip
    return planes


@cache
def corner_rays(camera: PinholeCamera) -> np.ndarray:  # [5, 3], camera frame, read-only
    """Return the camera's centre and the points at depth 1 on the rays through the four corners of the image."""
    c = camera
    corners = [((u - c.cx) / c.fx, (v - c.cy) / c.fy, 1.0) for v in (0.0, c.height) for u in (0.0, c.width)]
    points = np.array([(0.0, 0.0, 0.0), *corners])
    points.setflags(write=False)
    return points


def part_steps() -> np.ndarray:  # [4] in voxels
    """Return the centres of a voxel's parts along one axis, relative to the voxel's centre."""
    return (np.arange(PARTS_PER_SIDE) + 0.5) / PARTS_PER_SIDE - 0.5


@cache
def part_centers() -> np.ndarray:  # [64, 3] in voxels, read-only
    """Return the centre of each of the 64 parts of a voxel relative to the voxel's centre, in the order of the bits."""
    steps = part_steps()
    centers = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    centers.setflags(write=False)
    return centers


@kernel
def carve(look: Look, frustum: Frustum, voxels: VoxelFields, caution: Caution) -> None:
    """Update the TSDF and the state of every voxel that touches the view frustum of one depth image."""
    image_number, fresh, depth, pyramid, levels, lens, camera_from_world = look
    planes, reach, sides, extents, lower, upper = frustum
    origin, voxel_size, state, solidity, miss_chance, parts, last_hit, tsdf, weight = voxels
    margin, margin_growth, thinnest, max_miss_chance, truncation, max_weight = caution
    fx, fy, cx, cy = lens
    height, width = levels[0, 1], levels[0, 2]
    rotation = camera_from_world
    extent_x, extent_y, extent_z = extents
    sure_range = thinnest * min(fx, fy)  # up to this range no thin structure fits between two rays
    left_of, right_of, above, below = planes[0, 2], planes[1, 2], planes[2, 2], planes[3, 2]
    dx, dy, dz = rotation[0, 2] * voxel_size, rotation[1, 2] * voxel_size, rotation[2, 2] * voxel_size

    for i in range(lower[0], upper[0]):
        wx = origin[0] + (i + 0.5) * voxel_size
        for j in range(lower[1], upper[1]):
            wy = origin[1] + (j + 0.5) * voxel_size
            wz = origin[2] + 0.5 * voxel_size
            # Camera-frame point of voxel (i, j, 0).
            bx = rotation[0, 0] * wx + rotation[0, 1] * wy + rotation[0, 2] * wz + camera_from_world[0, 3]
            by = rotation[1, 0] * wx + rotation[1, 1] * wy + rotation[1, 2] * wz + camera_from_world[1, 3]
            bz = rotation[2, 0] * wx + rotation[2, 1] * wy + rotation[2, 2] * wz + camera_from_world[2, 3]
            first, last = float(lower[2]), float(upper[2] - 1)
            for p in range(6):
                # A column of voxels intersects the frustum in one interval. For the four sides, any part of a voxel
                # counts.
                offset = planes[p, 0] * bx + planes[p, 1] * by + planes[p, 2] * bz - planes[p, 3]
                if p < 4:
                    offset += reach[p]
                slope = planes[p, 0] * dx + planes[p, 1] * dy + planes[p, 2] * dz
                if slope > 1e-12:
                    first = max(first, -offset / slope)
                elif slope < -1e-12:
                    last = min(last, -offset / slope)
                elif offset < 0.0:
                    last = first - 1.0
                if last < first:
                    break
            for k in range(int(np.ceil(first)), int(np.floor(last)) + 1):
                x, y, z = bx + k * dx, by + k * dy, bz + k * dz
                u = min(max(int(fx * x / z + cx), 0), width - 1)
                v = min(max(int(fy * y / z + cy), 0), height - 1)
                distance = depth[v, u] - z
                if depth[v, u] > 0.0 and distance > -truncation:
                    # The voxel's centre is within the outermost rays.
                    if (
                        fx * x + left_of * z >= 0.0 and right_of * z - fx * x >= 0.0
                        and fy * y + above * z >= 0.0 and below * z - fy * y >= 0.0
                    ):  # fmt: skip
                        old = weight[i, j, k]
                        new = min(distance / truncation, 1.0)
                        tsdf[i, j, k] = (tsdf[i, j, k] * old + new) / (old + 1.0)
                        weight[i, j, k] = min(old + 1.0, max_weight)

                if last_hit[i, j, k] == image_number or (miss_chance[i, j, k] == 0.0 and solidity[i, j, k] == 0):
                    continue
                near, far = z - extent_z, z + extent_z
                if near < _MIN_DEPTH_M:
                    continue
                enough = far + margin + margin_growth * far * far
                if pyramid[v * width + u] <= enough:
                    continue
                left = fx * min((x - extent_x) / near, (x - extent_x) / far) + cx
                right = fx * max((x + extent_x) / near, (x + extent_x) / far) + cx
                top = fy * min((y - extent_y) / near, (y - extent_y) / far) + cy
                bottom = fy * max((y + extent_y) / near, (y + extent_y) / far) + cy
                partly = left < 0.5 or right > width - 0.5 or top < 0.5 or bottom > height - 0.5
                if partly and (far > sure_range or solidity[i, j, k] > 0):
                    continue
                # Include one ray on each side, so at least 3 x 3 rays are tested.
                u0, u1 = max(int(max(left, 0.0)) - 1, 0), min(int(right) + 1, width - 1)
                v0, v1 = max(int(max(top, 0.0)) - 1, 0), min(int(bottom) + 1, height - 1)
                if _nearest_in_footprint(pyramid, levels, u0, u1, v0, v1, enough) <= enough:
                    continue

                if partly:
                    proven = parts[i, j, k]
                    for n in range(PARTS_PER_SIDE**3):
                        inside = True
                        for p in range(4):
                            at = planes[p, 0] * x + planes[p, 1] * y + planes[p, 2] * z
                            inside = inside and at + sides[n, p] >= 0.0
                        if inside:
                            proven |= _ONE << np.uint64(n)
                    parts[i, j, k] = proven
                    if proven == ALL_PARTS:
                        miss_chance[i, j, k] = 0.0
                        state[i, j, k] = FREE
                    continue

                # Probability that a ray meets a thin structure in the voxel.
                met = min(1.0, sure_range / far)
                if not fresh and (met < 1.0 or solidity[i, j, k] > 0):
                    continue  # the same rays again give no information
                missed = miss_chance[i, j, k] * (1.0 - met)
                miss_chance[i, j, k] = missed if missed > _SURE else 0.0
                if solidity[i, j, k] > 0 and met >= 1.0:
                    solidity[i, j, k] -= 1
                if solidity[i, j, k] > 0:
                    state[i, j, k] = OCCUPIED
                elif missed <= max_miss_chance:
                    state[i, j, k] = FREE
                else:
                    state[i, j, k] = UNKNOWN
