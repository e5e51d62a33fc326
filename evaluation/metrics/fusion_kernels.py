"""Fuse truncated signed distances on blocks of 8 x 8 x 8 voxels, and extract triangles, in compiled loops.

In all functions ``depth`` [K, H, W] is float32 metres along the optical axis, 0 = no surface. ``intrinsics`` [4] are
fx, fy, cx and cy in pixels. ``voxel`` is the side of a voxel and ``truncation`` the truncation distance, in metres.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel

SIDE = 8  # voxels along a side of a block


@kernel
def areas_of(triangles: np.ndarray, areas: np.ndarray) -> None:
    """Write the areas [T] in m^2 of the triangles [T, 3, 3] in metres, computed in float64."""
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay, az = np.float64(a[0]), np.float64(a[1]), np.float64(a[2])
        bx, by, bz = b[0] - ax, b[1] - ay, b[2] - az
        cx, cy, cz = c[0] - ax, c[1] - ay, c[2] - az
        x, y, z = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
        areas[t] = 0.5 * np.sqrt(x * x + y * y + z * z)


@kernel
def span(depth: np.ndarray, intrinsics: np.ndarray, poses: np.ndarray, truncation: float, bounds: np.ndarray) -> None:
    """Extend the bounding box of each image by its measured points.

    Along the ray of a pixel the box includes ``truncation`` metres before and behind the point. ``poses`` [K, 4, 4] are
    world_from_camera, and ``bounds`` [K, 2, 3] the lower and upper corners in metres, changed.
    """
    fx, fy, cx, cy = intrinsics
    for image in range(len(depth)):
        for v in range(depth.shape[1]):
            for u in range(depth.shape[2]):
                z = depth[image, v, u]
                if not z > 0.0:
                    continue
                x, y = (u + 0.5 - cx) / fx * z, (v + 0.5 - cy) / fy * z
                reach = truncation * np.sqrt(x * x + y * y + z * z) / z
                for axis in range(3):
                    pose = poses[image, axis]
                    place = pose[0] * x + pose[1] * y + pose[2] * z + pose[3]
                    bounds[image, 0, axis] = min(bounds[image, 0, axis], place - reach)
                    bounds[image, 1, axis] = max(bounds[image, 1, axis], place + reach)


@kernel
def mark_blocks(
    depth: np.ndarray,
    intrinsics: np.ndarray,
    poses: np.ndarray,  # [K, 4, 4] world_from_camera
    truncation: float,
    first: np.ndarray,  # [3] block index of the first element of ``marked``
    block: float,  # side of a block in metres
    marked: np.ndarray,  # [X, Y, Z] bool, changed
) -> None:
    """Mark the blocks within the truncation distance of each measured point, along its ray."""
    fx, fy, cx, cy = intrinsics
    where = np.empty(3, np.int64)
    steps = int(np.ceil(4.0 * truncation / block))  # each step is at most half a block along the optical axis
    for image in range(len(depth)):
        for v in range(depth.shape[1]):
            for u in range(depth.shape[2]):
                middle = depth[image, v, u]
                if not middle > 0.0:
                    continue
                for step in range(steps + 1):
                    z = middle + truncation * (2.0 * step / steps - 1.0)
                    x, y = (u + 0.5 - cx) / fx * z, (v + 0.5 - cy) / fy * z
                    pose = poses[image]
                    for axis in range(3):
                        place = pose[axis, 0] * x + pose[axis, 1] * y + pose[axis, 2] * z + pose[axis, 3]
                        where[axis] = int(np.floor(place / block)) - first[axis]
                    marked[where[0], where[1], where[2]] = True


class Blocks(NamedTuple):
    """Hold the fused distances of some blocks of voxels."""

    places: np.ndarray  # [B, 3] block indices
    distance: np.ndarray  # [B, 8, 8, 8] mean of the measured signed distances in metres, each at most the truncation
    weight: np.ndarray  # [B, 8, 8, 8] number of measured distances


_TILE = 8  # pixels along a side of a tile


@kernel
def range_of_tiles(depth: np.ndarray) -> np.ndarray:  # [K, H / 8, W / 8, 2] metres
    """Return the minimum and maximum depth of every tile of every image; a pixel without depth counts as 0."""
    images, height, width = depth.shape
    tiles = np.empty((images, (height + _TILE - 1) // _TILE, (width + _TILE - 1) // _TILE, 2), np.float32)
    tiles[..., 0], tiles[..., 1] = np.inf, 0.0
    for image in range(images):
        for v in range(height):
            for u in range(width):
                here = depth[image, v, u]
                here = here if here > 0.0 else np.float32(0.0)
                tile = tiles[image, v // _TILE, u // _TILE]
                tile[0], tile[1] = min(tile[0], here), max(tile[1], here)
    return tiles


@kernel
def integrate(
    depth: np.ndarray,  # [K, H, W] metres
    tiles: np.ndarray,  # [K, H / 8, W / 8, 2] minimum and maximum depth in metres, see `range_of_tiles`
    intrinsics: np.ndarray,
    camera_from_world: np.ndarray,  # [K, 3, 4]
    origin: np.ndarray,  # [3] lower corner of block (0, 0, 0), metres, world
    voxel: float,
    truncation: float,
    own: Blocks,  # changed
) -> None:
    """Add the measurements of depth images to the mean distances of blocks; skip images that cannot change a block."""
    blocks, distance, weight = own
    fx, fy, cx, cy = intrinsics
    height, width = depth.shape[1], depth.shape[2]
    block = 8 * voxel
    radius = 0.5 * np.sqrt(3.0) * block
    # A sphere outside just touches a side of the frustum if its centre is (slack x radius) away, along camera x or y.
    slack_x = np.sqrt(1.0 + (max(cx, width - cx) / fx) ** 2)
    slack_y = np.sqrt(1.0 + (max(cy, height - cy) / fy) ** 2)
    away, across, down = np.empty(8), np.empty(8), np.empty(8)
    for b in range(len(blocks)):
        corner_x = origin[0] + blocks[b, 0] * block
        corner_y = origin[1] + blocks[b, 1] * block
        corner_z = origin[2] + blocks[b, 2] * block
        for image in range(len(depth)):
            pose = camera_from_world[image]
            mx, my, mz = corner_x + 0.5 * block, corner_y + 0.5 * block, corner_z + 0.5 * block
            z = pose[2, 0] * mx + pose[2, 1] * my + pose[2, 2] * mz + pose[2, 3]
            if z < -radius:
                continue
            x = pose[0, 0] * mx + pose[0, 1] * my + pose[0, 2] * mz + pose[0, 3]
            y = pose[1, 0] * mx + pose[1, 1] * my + pose[1, 2] * mz + pose[1, 3]
            if x < -cx / fx * z - radius * slack_x or x > (width - cx) / fx * z + radius * slack_x:
                continue
            if y < -cy / fy * z - radius * slack_y or y > (height - cy) / fy * z + radius * slack_y:
                continue
            if z > 2.0 * radius:  # a nearer block may contain the camera
                reach = radius / (z - radius)
                spread_x, spread_y = reach * (fx + abs(x) / z * fx), reach * (fy + abs(y) / z * fy)
                low_u, high_u = fx * x / z + cx - spread_x, fx * x / z + cx + spread_x
                low_v, high_v = fy * y / z + cy - spread_y, fy * y / z + cy + spread_y
                least, most = np.float32(np.inf), np.float32(0.0)
                for row in range(max(0, int(low_v) // _TILE), min(height - 1, int(high_v)) // _TILE + 1):
                    for column in range(max(0, int(low_u) // _TILE), min(width - 1, int(high_u)) // _TILE + 1):
                        least = min(least, tiles[image, row, column, 0])
                        most = max(most, tiles[image, row, column, 1])
                if most - (z - radius) < -truncation:  # the whole block is occluded
                    continue
                inside = low_u >= 0.0 and low_v >= 0.0 and high_u < width and high_v < height
                if inside and least - (z + radius) >= truncation:  # the whole block is free
                    _add_free_space(distance[b], weight[b], truncation)
                    continue
            for i in range(8):
                for j in range(8):
                    px, py = corner_x + (i + 0.5) * voxel, corner_y + (j + 0.5) * voxel
                    x = pose[0, 0] * px + pose[0, 1] * py
                    y = pose[1, 0] * px + pose[1, 1] * py
                    z = pose[2, 0] * px + pose[2, 1] * py
                    for k in range(8):  # a loop of its own, which the compiler vectorises
                        pz = corner_z + (k + 0.5) * voxel
                        away[k] = z + pose[2, 2] * pz + pose[2, 3]
                        across[k] = fx * (x + pose[0, 2] * pz + pose[0, 3]) / away[k] + cx
                        down[k] = fy * (y + pose[1, 2] * pz + pose[1, 3]) / away[k] + cy
                    _add_row(away, across, down, depth[image], truncation, distance[b, i, j], weight[b, i, j])


@kernel
def _add_row(
    away: np.ndarray,  # [8] depths of the voxel centres along the optical axis, metres
    across: np.ndarray,  # [8] their x coordinates in the image, pixels
    down: np.ndarray,  # [8] their y coordinates in the image, pixels
    depth: np.ndarray,  # [H, W] metres
    truncation: float,
    distance: np.ndarray,  # [8] metres, changed
    weight: np.ndarray,  # [8] changed
) -> None:
    """Add the measurements of one depth image to the mean distances of 8 voxels in a row."""
    height, width = depth.shape
    for k in range(8):
        z, u, v = away[k], across[k], down[k]
        if not (z >= 0.05 and 0.0 <= u < width and 0.0 <= v < height):
            continue
        seen = depth[int(v), int(u)]
        ahead = seen - z
        if not seen > 0.0 or ahead < -truncation:
            continue
        count = weight[k]
        distance[k] = (distance[k] * count + min(ahead, truncation)) / (count + 1.0)
        weight[k] = count + 1.0


@kernel
def _add_free_space(distance: np.ndarray, weight: np.ndarray, truncation: float) -> None:
    """Add one measurement of free space, with the distance ``truncation``, to all voxels [8, 8, 8] of a block."""
    for i in range(8):
        for j in range(8):
            for k in range(8):
                count = weight[i, j, k]
                distance[i, j, k] = (distance[i, j, k] * count + truncation) / (count + 1.0)
                weight[i, j, k] = count + 1.0


# The corner numbers of the six tetrahedra around the diagonal from corner 0 to corner 7 of a cell. Bits 0, 1 and 2 of a
# corner's number are its x, y and z. All cells are divided equally, so adjacent cells share the diagonals of their
# common face, and there are no cracks.
_TETRAHEDRA = np.array(
    [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]], dtype=np.int64
)


@kernel
def triangles(
    distance: np.ndarray,  # [L, 8, 8, 8] metres, see `Blocks`
    weight: np.ndarray,  # [L, 8, 8, 8]
    neighbours: np.ndarray,  # [B, 8] rows of a block and its 7 neighbours in positive x, y and z; -1 = no such block
    blocks: np.ndarray,  # [B, 3] block indices; their cells are processed
    origin: np.ndarray,  # [3] lower corner of block (0, 0, 0), metres, world
    voxel: float,
    oriented: bool,
    corners: np.ndarray,  # [T, 3, 3] out: the first T triangles, metres, world
) -> int:
    """Extract the zero level by marching tetrahedra over the cells between voxel centres; return the triangle count.

    The count can exceed T; then the caller repeats the call with a larger array. If ``oriented``, the corners of a
    triangle are counter-clockwise seen from the side of positive distances. Protocols sample triangles in the other
    order, so their numbers depend on it.
    """
    value, place = np.empty(8), np.empty((8, 3))
    crossing = np.empty((4, 3))
    near, unseen = np.empty((9, 9, 9), np.float32), np.empty((9, 9, 9), np.bool_)
    count = 0
    for b in range(len(blocks)):
        if not _with_neighbours(distance, weight, neighbours[b], near, unseen):
            continue
        for cell in range(512):
            i, j, k = cell >> 6, (cell >> 3) & 7, cell & 7
            inside = 0
            known = True
            for corner in range(8):
                gi, gj, gk = i + (corner & 1), j + ((corner >> 1) & 1), k + ((corner >> 2) & 1)
                if unseen[gi, gj, gk]:
                    known = False
                    break
                value[corner] = near[gi, gj, gk]
                inside += value[corner] < 0.0
            if not known or inside == 0 or inside == 8:
                continue
            for corner in range(8):
                gi, gj, gk = i + (corner & 1), j + ((corner >> 1) & 1), k + ((corner >> 2) & 1)
                place[corner, 0] = origin[0] + (blocks[b, 0] * 8 + gi + 0.5) * voxel
                place[corner, 1] = origin[1] + (blocks[b, 1] * 8 + gj + 0.5) * voxel
                place[corner, 2] = origin[2] + (blocks[b, 2] * 8 + gk + 0.5) * voxel
            for tetrahedron in _TETRAHEDRA:
                found = 0
                behind = 0
                for a in range(4):
                    behind += value[tetrahedron[a]] < 0.0
                if behind == 0 or behind == 4:
                    continue
                # Order the cut edges around the polygon. Each edge leads from a corner on the side with fewer corners
                # to a corner on the other side.
                if behind == 2:
                    low, other_low, high, other_high = -1, -1, -1, -1
                    for a in range(4):
                        corner = tetrahedron[a]
                        if value[corner] < 0.0:
                            low, other_low = (corner, -1) if low < 0 else (low, corner)
                        else:
                            high, other_high = (corner, -1) if high < 0 else (high, corner)
                    _cut(value, place, low, high, crossing[0])
                    _cut(value, place, low, other_high, crossing[1])
                    _cut(value, place, other_low, other_high, crossing[2])
                    _cut(value, place, other_low, high, crossing[3])
                    found = 4
                else:
                    lonely = behind == 1
                    tip = 0
                    for a in range(4):
                        if (value[tetrahedron[a]] < 0.0) == lonely:
                            tip = tetrahedron[a]
                    for a in range(4):
                        if tetrahedron[a] != tip:
                            _cut(value, place, tip, tetrahedron[a], crossing[found])
                            found += 1
                for third in range(2, found):
                    if count < len(corners):
                        for axis in range(3):
                            corners[count, 0, axis] = crossing[0, axis]
                            corners[count, 1, axis] = crossing[third - 1, axis]
                            corners[count, 2, axis] = crossing[third, axis]
                        if oriented:
                            _turn(value, place, tetrahedron, corners[count])
                    count += 1
    return count


@kernel
def _turn(value: np.ndarray, place: np.ndarray, tetrahedron: np.ndarray, triangle: np.ndarray) -> None:
    """Exchange two corners of a triangle [3, 3] in a tetrahedron unless its normal points to positive distances."""
    ahead = np.zeros(3)
    behind = 0
    for a in range(4):
        behind += value[tetrahedron[a]] < 0.0
    for a in range(4):
        share = -1.0 / behind if value[tetrahedron[a]] < 0.0 else 1.0 / (4 - behind)
        for axis in range(3):
            ahead[axis] += share * place[tetrahedron[a], axis]
    side = 0.0
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        first = (triangle[1, i] - triangle[0, i]) * (triangle[2, j] - triangle[0, j])
        second = (triangle[1, j] - triangle[0, j]) * (triangle[2, i] - triangle[0, i])
        side += ahead[axis] * (first - second)
    if side < 0.0:
        for axis in range(3):
            kept = triangle[1, axis]
            triangle[1, axis] = triangle[2, axis]
            triangle[2, axis] = kept


@kernel
def _with_neighbours(
    distance: np.ndarray,
    weight: np.ndarray,
    rows: np.ndarray,  # [8] rows of the block and its neighbours, see `triangles`
    near: np.ndarray,  # [9, 9, 9] out: distances in metres
    unseen: np.ndarray,  # [9, 9, 9] out: whether a voxel has no measurement
) -> bool:
    """Copy the distances of a block and of the adjacent voxels in its neighbours; return whether both signs occur."""
    before, behind = False, False
    for gi in range(9):
        for gj in range(9):
            for gk in range(9):
                slot = rows[((gi >> 3) << 2) + ((gj >> 3) << 1) + (gk >> 3)]
                lost = slot < 0 or weight[slot, gi & 7, gj & 7, gk & 7] == 0.0
                unseen[gi, gj, gk] = lost
                if not lost:
                    here = distance[slot, gi & 7, gj & 7, gk & 7]
                    near[gi, gj, gk] = here
                    before, behind = before or here >= 0.0, behind or here < 0.0
    return before and behind


@kernel
def _cut(value: np.ndarray, place: np.ndarray, a: int, b: int, out: np.ndarray) -> None:
    """Write the zero crossing on the edge between corners ``a`` and ``b`` of a cell to ``out`` [3], metres.

    It is interpolated linearly between the distances ``value`` [8] at the corner positions ``place`` [8, 3].
    """
    share = value[a] / (value[a] - value[b])
    for axis in range(3):
        out[axis] = place[a, axis] + share * (place[b, axis] - place[a, axis])
