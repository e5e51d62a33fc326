"""Distances on the voxel grid: the exact distance from voxel centres to voxel cubes, and sampling it along segments."""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel

# Squared voxels; larger than any distance in a grid, small enough that float32 sums keep their order.
_FAR = np.float32(1e12)
# Voxels before the end of a line of sight that may be occupied: they hold the surface that is looked at.
SPARED = 2.0


def bounding_box(
    mask: np.ndarray,  # [X, Y, Z] bool, not all false
) -> tuple[np.ndarray, np.ndarray]:  # ([3] lower, [3] upper) int64 indices, upper exclusive
    """The smallest box that holds all true voxels."""
    lower, upper = np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64)
    columns = np.asarray(mask.any(axis=2))
    for axis, some in enumerate((columns.any(axis=1), columns.any(axis=0), mask.any(axis=(0, 1)))):
        present = np.flatnonzero(some)
        lower[axis], upper[axis] = present[0], present[-1] + 1
    return lower, upper


def cut_out(
    array: np.ndarray,  # [X, Y, Z]
    lower: np.ndarray,  # [3] int64, may be negative
    upper: np.ndarray,  # [3] int64, exclusive, may lie beyond the array
) -> np.ndarray:
    """A copy of the box from ``lower`` to ``upper``, 0 where it reaches out of the array."""
    box = np.zeros(tuple(upper - lower), array.dtype)
    first, last = np.maximum(lower, 0), np.minimum(upper, array.shape)
    source = tuple(slice(a, b) for a, b in zip(first, last))
    box[tuple(slice(a, b) for a, b in zip(first - lower, last - lower))] = array[source]
    return box


@kernel
def _pass(
    values: np.ndarray,  # [A, B, N], in place along the last axis (any strides)
    costs: np.ndarray,  # [N + 1] float32: (n - 1/2)^2, the last one infinite
    line: np.ndarray,  # [3 N] float32, all _FAR: room on both sides, so that no step needs a bounds check
) -> None:
    """``out[n] = min_m values[m] + max(0, |n - m| - 1/2)^2``: squared distance to cubes, one axis at a time."""
    length = values.shape[2]
    for a in range(values.shape[0]):
        for b in range(values.shape[1]):
            for n in range(length):
                line[length + n] = values[a, b, n]
            for n in range(length):
                best = line[length + n]
                # Outwards until nothing further away can be nearer. Clearances are short, so this is a few steps.
                step = 1
                while costs[step] < best:
                    best = min(best, min(line[length + n - step], line[length + n + step]) + costs[step])
                    step += 1
                values[a, b, n] = best


def distance_to_cubes(
    obstacle: np.ndarray,  # [X, Y, Z] bool
    *,
    at_most: float = np.inf,  # voxels: larger distances are cut to this, which saves time
) -> np.ndarray:  # [X, Y, Z] float32, in voxels; inf where there is no obstacle at all
    """Distance from the centre of every voxel to the nearest point of the nearest obstacle voxel's *cube*; 0 inside.

    A Euclidean distance transform measures from centre to centre and is between 0.5 and 0.87 voxels too long.
    This one is exact, and faster: 7 ms against 20 to 24 ms of scipy (10 x 8 x 2.7 m at 0.1 m, two thirds free).
    """
    squared = np.where(obstacle, np.float32(0.0), np.float32(min(float(_FAR), at_most**2)))
    for axis in (2, 1, 0):
        length = obstacle.shape[axis]
        costs = (np.arange(length + 1, dtype=np.float32) - np.float32(0.5)) ** 2
        costs[length] = np.inf
        _pass(np.moveaxis(squared, axis, 2), costs, np.full(3 * length, _FAR))
    distance = np.sqrt(squared, out=squared)
    if at_most == np.inf:
        distance[distance > 1e5] = np.inf
    return distance


@kernel
def sample(
    field: np.ndarray,  # [X, Y, Z] float32, values at voxel centres
    x: float,  # in voxels; the centre of voxel (0, 0, 0) is (0, 0, 0)
    y: float,
    z: float,
) -> float:
    """Trilinear interpolation; beyond the grid the field is 0."""
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
                if w > 0.0:  # keeps 0 * inf out
                    total += w * field[i + di, j + dj, k + dk]
    return total


@kernel
def sample_points(
    field: np.ndarray,
    points: np.ndarray,  # [N, 3] in voxels
) -> np.ndarray:  # [N] float32
    """`sample` for many points."""
    values = np.empty(len(points), np.float32)
    for n in range(len(points)):
        values[n] = sample(field, points[n, 0], points[n, 1], points[n, 2])
    return values


@kernel
def segment_above(
    field: np.ndarray,
    start: np.ndarray,  # [3] in voxels
    end: np.ndarray,  # [3]
    bound: float,
    step: float,  # in voxels
) -> bool:
    """Whether the field is at least ``bound`` at both ends and at samples at most ``step`` apart between them."""
    dx, dy, dz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    count = max(1, int(np.ceil(np.sqrt(dx * dx + dy * dy + dz * dz) / step)))
    for n in range(count, -1, -1):  # the new end first: in a search that is where it fails
        t = n / count
        if sample(field, start[0] + t * dx, start[1] + t * dy, start[2] + t * dz) < bound:
            return False
    return True


@kernel
def segments_above(
    field: np.ndarray,
    starts: np.ndarray,  # [N, 3] in voxels
    ends: np.ndarray,  # [N, 3]
    bound: float,
    step: float,
) -> np.ndarray:  # [N] bool
    """`segment_above` for many segments."""
    above = np.empty(len(starts), np.bool_)
    for n in range(len(starts)):
        above[n] = segment_above(field, starts[n], ends[n], bound, step)
    return above


@kernel
def sight_line(
    blocking: np.ndarray,  # [X, Y, Z] bool
    x: float,  # start, in voxels; the lower corner of voxel (0, 0, 0) is (0, 0, 0)
    y: float,
    z: float,
    end_x: float,
    end_y: float,
    end_z: float,
    spared: float,  # in voxels: this much before the end is not looked at
) -> bool:
    """Whether no blocking voxel lies on the way from start to end (every voxel the line enters is looked at).

    Single numbers, because a row cut out of an array in a loop is counted as a reference, twice.
    """
    dx, dy, dz = end_x - x, end_y - y, end_z - z
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    limit = 1.0 - spared / length if length > spared else 0.0
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    # Line parameters from one boundary of each axis to the next, and at which the first one is crossed.
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
    blocking: np.ndarray,
    starts: np.ndarray,  # [N, 3] in voxels
    ends: np.ndarray,  # [N, 3]
    spared: float,  # in voxels
) -> np.ndarray:  # [N] bool
    """`sight_line` for many lines."""
    clear = np.empty(len(starts), np.bool_)
    for n in range(len(starts)):
        clear[n] = sight_line(
            blocking, starts[n, 0], starts[n, 1], starts[n, 2], ends[n, 0], ends[n, 1], ends[n, 2], spared
        )
    return clear
