"""Compute distances from voxel centres to the nearest obstacle voxels, and sample them along segments."""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel

# A squared distance larger than any in a grid, in quarters of a squared voxel; sums still fit into 32 bits.
FAR = 1 << 30
# Length in voxels at the end of a line of sight that is not tested, because the target surface itself is there.
SPARED = 2.0


def bounding_box(
    mask: np.ndarray,  # [X, Y, Z] bool
) -> tuple[np.ndarray, np.ndarray]:  # [3] lower and [3] upper index, int64, upper exclusive; 0 for an empty mask
    """Return the smallest box of voxels that contains all true voxels of a mask."""
    lower, upper = _bounding_box(np.ascontiguousarray(mask).view(np.uint8))
    return lower, upper


@kernel
def _bounding_box(mask: np.ndarray) -> np.ndarray:  # [2, 3] int64
    box = np.zeros((2, 3), np.int64)
    box[0, 0], box[0, 1], box[0, 2] = mask.shape
    for i in range(mask.shape[0]):
        for j in range(mask.shape[1]):
            some = np.uint8(0)
            for k in range(mask.shape[2]):  # most columns are empty, and the compiler vectorises this loop
                some |= mask[i, j, k]
            if not some:
                continue
            first, last = 0, mask.shape[2] - 1
            while not mask[i, j, first]:
                first += 1
            while not mask[i, j, last]:
                last -= 1
            box[0, 0], box[0, 1], box[0, 2] = min(box[0, 0], i), min(box[0, 1], j), min(box[0, 2], first)
            box[1, 0], box[1, 1], box[1, 2] = i + 1, max(box[1, 1], j + 1), max(box[1, 2], last + 1)
    return box


def cut_out(
    array: np.ndarray,  # [X, Y, Z]
    lower: np.ndarray,  # [3] int64 index, may be negative
    upper: np.ndarray,  # [3] int64 index, exclusive, may be beyond the array
) -> np.ndarray:
    """Return a copy of the box from index ``lower`` to index ``upper``, with 0 outside the array."""
    box = np.zeros(tuple(upper - lower), array.dtype)
    first, last = np.maximum(lower, 0), np.minimum(upper, array.shape)
    source = tuple(slice(a, b) for a, b in zip(first, last))
    box[tuple(slice(a, b) for a, b in zip(first - lower, last - lower))] = array[source]
    return box


@kernel
def _along_columns(
    obstacle: np.ndarray,  # [X, Y, Z] bool
    most: int,  # largest value of the result
) -> np.ndarray:  # [X, Y, Z] int32, quarters of a squared voxel
    """Return the squared distance of each voxel centre to the nearest obstacle cube in the same column (along z)."""
    width, depth, height = obstacle.shape
    squared = np.empty(obstacle.shape, np.int32)
    for i in range(width):
        for j in range(depth):
            away = 1 << 14
            for k in range(height):
                away = 0 if obstacle[i, j, k] else away + 1
                squared[i, j, k] = away
            away = 1 << 14
            for k in range(height - 1, -1, -1):
                away = 0 if obstacle[i, j, k] else away + 1
                near = min(away, int(squared[i, j, k]))
                squared[i, j, k] = min((2 * near - 1) ** 2, most) if near > 0 else 0
    return squared


@kernel
def _across_columns(
    values: np.ndarray,  # [A * N * B * height] int32, changed in place
    lines: np.ndarray,  # [N * height] int32, workspace
    outer: int,  # number A
    length: int,  # number N of voxels along the axis
    inner: int,  # number B
    height: int,  # voxels of a column
) -> None:
    """Compute the minimum over m of values[m] + (2 max(0, |n - m| - 1/2))^2 for all n along one axis, in place.

    This adds the distance along the axis to squared distances in quarters of a squared voxel. It treats the voxels of a
    column together in a vectorised loop over integers. The search over m moves outwards from n and stops when no
    farther m can give a smaller value. It takes few steps, since clearances are short.
    """
    stride = inner * height
    for a in range(outer):
        for b in range(inner):
            first = a * length * stride + b * height
            for n in range(length):
                lines[n * height : (n + 1) * height] = values[first + n * stride : first + n * stride + height]
            for n in range(length):
                out = values[first + n * stride : first + n * stride + height]
                farthest = np.int32(0)
                for k in range(height):
                    farthest = max(farthest, out[k])
                step = 1
                while step < length and (2 * step - 1) ** 2 < farthest:
                    cost = np.int32((2 * step - 1) ** 2)
                    low, high = max(n - step, 0) * height, min(n + step, length - 1) * height
                    before, after = lines[low : low + height], lines[high : high + height]
                    farthest = np.int32(0)
                    for k in range(height):
                        best = min(out[k], np.int32(min(before[k], after[k]) + cost))
                        out[k] = best
                        farthest = max(farthest, best)
                    step += 1


def squared_distances(
    obstacle: np.ndarray,  # [X, Y, Z] bool
    at_most: float = np.inf,  # voxels: larger distances need not be exact, which saves time
) -> np.ndarray:  # [X, Y, Z] int32, quarters of a squared voxel
    """Return the squared distance of each voxel centre to the nearest obstacle voxel's cube; 0 inside obstacles.

    Without an obstacle every entry is `FAR`. A Euclidean distance transform measures from centre to centre, which is
    0.5 to 0.87 voxels too long. This transform is exact and separable: 2 ms against 20 to 24 ms of scipy (10 x 8 x 2.7
    m at 0.1 m, two thirds free).
    """
    width, depth, height = obstacle.shape
    quarters: np.ndarray = _along_columns(obstacle, int(min(float(FAR), np.ceil(4.0 * at_most**2))))
    lines = np.empty(max(width, depth) * height, np.int32)
    _across_columns(quarters.ravel(), lines, width, depth, 1, height)
    _across_columns(quarters.ravel(), lines, 1, width, depth, height)
    return quarters


@kernel
def root_of(
    quarters: int,  # entry of `squared_distances`
    most: np.float32,  # squared voxels, limit of the squared distance; inf = none
) -> np.float32:
    """Return the distance in voxels; inf without an obstacle and a limit."""
    square = np.float32(quarters) * np.float32(0.25) if quarters < FAR else np.float32(np.inf)
    return np.sqrt(min(square, most))


@kernel
def join_distances(
    any_kind: np.ndarray,  # [X, Y, Z] int32, `squared_distances` to voxels that are not free
    most_any: np.float32,  # squared voxels, limit of these distances
    occupied: np.ndarray,  # [X, Y, Z] int32, `squared_distances` to occupied voxels
    most_occupied: np.float32,  # squared voxels, limit of these distances
    slack: np.float32,  # voxels added to ``any_kind``, so that unknown space counts as farther away
    voxel_size: np.float32,  # metres
    out: np.ndarray,  # [X, Y, Z] float32 metres, output
) -> None:
    """Write the clearance of each voxel (`VoxelVolume.clearance`), computed from two distance fields."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            for k in range(out.shape[2]):
                if any_kind[i, j, k] <= 0:
                    out[i, j, k] = np.float32(0.0)
                    continue
                away = root_of(any_kind[i, j, k], most_any) + slack
                out[i, j, k] = min(away, root_of(occupied[i, j, k], most_occupied)) * voxel_size


@kernel
def sample(
    field: np.ndarray,  # [X, Y, Z] float32, values at voxel centres
    x: float,  # point in voxels; the centre of voxel (0, 0, 0) is at (0, 0, 0)
    y: float,
    z: float,
) -> float:
    """Return the field at a point by trilinear interpolation. Outside the grid the field is 0."""
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    a, b, c = x - i, y - j, z - k
    total = 0.0
    for di in range(2):
        if not 0 <= i + di < field.shape[0]:
            continue
        wi = a if di else 1.0 - a
        for dj in range(2):
            if not 0 <= j + dj < field.shape[1]:
                continue
            wj = wi * (b if dj else 1.0 - b)
            for dk in range(2):
                if not 0 <= k + dk < field.shape[2]:
                    continue
                w = wj * (c if dk else 1.0 - c)
                if w > 0.0:  # avoids 0 * inf
                    total += w * field[i + di, j + dj, k + dk]
    return total


@kernel
def sample_points(
    field: np.ndarray,  # [X, Y, Z] float32
    points: np.ndarray,  # [N, 3] in voxels
) -> np.ndarray:  # [N] float32
    """Return the field at many points, as `sample`."""
    values = np.empty(len(points), np.float32)
    for n in range(len(points)):
        values[n] = sample(field, points[n, 0], points[n, 1], points[n, 2])
    return values


@kernel
def segment_above(
    field: np.ndarray,  # [X, Y, Z] float32
    start: np.ndarray,  # [3] in voxels
    end: np.ndarray,  # [3] in voxels
    bound: float,  # in the field's unit
    step: float,  # largest distance between samples, in voxels
) -> bool:
    """Return whether the field is at least ``bound`` at both ends of a segment and at samples along it."""
    dx, dy, dz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    count = max(1, int(np.ceil(np.sqrt(dx * dx + dy * dy + dz * dz) / step)))
    for n in range(count, -1, -1):  # the end comes first: a search tests new ends, which fail most often
        t = n / count
        if sample(field, start[0] + t * dx, start[1] + t * dy, start[2] + t * dz) < bound:
            return False
    return True


@kernel
def segments_above(
    field: np.ndarray,  # [X, Y, Z] float32
    starts: np.ndarray,  # [N, 3] in voxels
    ends: np.ndarray,  # [N, 3] in voxels
    bound: float,  # in the field's unit
    step: float,  # largest distance between samples, in voxels
) -> np.ndarray:  # [N] bool
    """Return for many segments whether the field is at least ``bound`` along them, as `segment_above`."""
    above = np.empty(len(starts), np.bool_)
    for n in range(len(starts)):
        above[n] = segment_above(field, starts[n], ends[n], bound, step)
    return above


@kernel
def sight_line(
    blocking: np.ndarray,  # [X, Y, Z] bool
    x: float,  # start in voxels; the lower corner of voxel (0, 0, 0) is at (0, 0, 0)
    y: float,
    z: float,
    end_x: float,  # end in voxels
    end_y: float,
    end_z: float,
    spared: float,  # length before the end that is not tested, in voxels
) -> bool:
    """Return whether the line from start to end enters no blocking voxel before its end, in whichever voxel it starts.

    The points are given as numbers and not as arrays, since numba counts references to rows of arrays in loops.
    """
    dx, dy, dz = end_x - x, end_y - y, end_z - z
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    limit = 1.0 - spared / length if length > spared else 0.0
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    # Line parameters: distance between two voxel boundaries of each axis, and position of the first boundary.
    step_x, step_y, step_z = 1.0 / abs(dx), 1.0 / abs(dy), 1.0 / abs(dz)
    next_x = ((i + 1 if dx > 0 else i) - x) / dx if dx != 0.0 else np.inf
    next_y = ((j + 1 if dy > 0 else j) - y) / dy if dy != 0.0 else np.inf
    next_z = ((k + 1 if dz > 0 else k) - z) / dz if dz != 0.0 else np.inf
    while True:
        if next_z < min(next_x, next_y):
            crossed = next_z
            next_z += step_z
            k += 1 if dz > 0 else -1
        elif next_y < next_x:
            crossed = next_y
            next_y += step_y
            j += 1 if dy > 0 else -1
        else:
            crossed = next_x
            next_x += step_x
            i += 1 if dx > 0 else -1
        if crossed >= limit:
            return True
        inside = 0 <= i < blocking.shape[0] and 0 <= j < blocking.shape[1] and 0 <= k < blocking.shape[2]
        if inside and blocking[i, j, k]:
            return False


@kernel
def sight_lines(
    blocking: np.ndarray,  # [X, Y, Z] bool
    starts: np.ndarray,  # [N, 3] in voxels
    ends: np.ndarray,  # [N, 3] in voxels
    spared: float,  # length before each end that is not tested, in voxels
) -> np.ndarray:  # [N] bool
    """Return for many lines whether they enter no blocking voxel, as `sight_line`."""
    clear = np.empty(len(starts), np.bool_)
    for n in range(len(starts)):
        clear[n] = sight_line(
            blocking, starts[n, 0], starts[n, 1], starts[n, 2], ends[n, 0], ends[n, 1], ends[n, 2], spared
        )
    return clear
