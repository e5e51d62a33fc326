"""Where a plane was seen but the map is coarser than the plane's own grid.

Eq. 6 asks which cells of a plane are occupied by reconstructed points. A wall seen from far away has depth in every
cell and Gaussians in few of them; the pixels it fills look covered from wherever it was seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.planes.nodes import PlaneNode
from activestructure_gym.planes.surface import GridStack, stack_grids

_VOXEL = 0.7  # of a cell: a point in the same or a neighbouring voxel lies within about one cell
_CORNERS = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])  # of a rectangle of cells, as shares of its edges


@dataclass(frozen=True)
class MapPoints:
    """What the Plane Scene Graph knows of the map: where its Gaussians are and how large."""

    means: np.ndarray  # [M, 3] metres, world
    sizes: np.ndarray  # [M] metres, middle one of the three standard deviations: the short one in the plane of a disk

    @classmethod
    def from_log_scales(cls, means: np.ndarray, log_scales: np.ndarray) -> MapPoints:
        """From the map's own arrays, each [3, M] (metres; logarithms of metres)."""
        a, b, c = log_scales
        return cls(means.T, np.exp(np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))))


@dataclass(frozen=True)
class SparsePatches:
    """Square patches of planes that the map covers too coarsely."""

    centres: np.ndarray  # [D, 3] metres, world
    areas: np.ndarray  # [D] m^2 of the cells concerned
    sizes: np.ndarray  # [D] metres, mean size of the Gaussians there
    planes: np.ndarray  # [D] int64 index of the plane


def sparse_patches(
    nodes: Sequence[PlaneNode],
    points: MapPoints,
    *,
    tile: int,  # cells along the edge of a patch
    least_cells: int,  # concerned, for a patch to count
    largest: float,  # metres: a cell is fine where a Gaussian up to this size lies within about a cell
) -> SparsePatches:
    """Patches in which seen cells have no Gaussian near that is fine enough; in a map without any, all that was seen.

    A patch without a Gaussian near is given twice the size ``largest``.
    """
    surfaces = [node.surface for node in nodes]
    if not surfaces:
        return SparsePatches(np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.zeros(0, np.int64))
    grids, cell = stack_grids(surfaces), surfaces[0].cell
    finest, low, first = _finest_near(grids, points, cell)
    tiles = (-(-grids.shapes // tile)).prod(axis=1).sum()
    found, planes = np.empty((tiles, 5)), np.empty(tiles, np.int64)
    count = _coarse_tiles(
        np.concatenate([surface.seen.ravel() for surface in surfaces]),
        grids.starts, grids.shapes, grids.lows, grids.frames, cell,
        finest, low, first, largest, tile, least_cells, found, planes,
    )  # fmt: skip
    return SparsePatches(found[:count, :3], found[:count, 3] * cell**2, found[:count, 4], planes[:count])


def _finest_near(
    grids: GridStack, points: MapPoints, cell: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # [X, Y, Z] float32 metres, [3] metres, [3] int64
    """The finest Gaussian of every voxel and its two neighbours in z; the corner of voxel (0, 0, 0); the first voxel.

    Voxels are counted from the lowest Gaussian but stored only around the planes: one Gaussian that strayed far off
    must not ask for a grid that reaches as far.
    """
    if not len(points.means):
        return np.zeros((1, 1, 1), np.float32), np.zeros(3), np.zeros(3, np.int64)
    voxel = _VOXEL * cell
    means = np.ascontiguousarray(np.asarray(points.means).T, dtype=np.float32)  # [3, M]
    low = means.min(axis=1).astype(np.float64) - 2 * voxel
    last = np.ceil((means.max(axis=1) - low) / voxel).astype(np.int64) + 2
    corner = (grids.lows[:, None] + _CORNERS * grids.shapes[:, None]) * cell  # [N, 4, 2]
    corners = grids.frames[:, None, :3] + corner @ grids.frames[:, 3:9].reshape(-1, 2, 3)  # [N, 4, 3] world
    first = np.floor((corners.min(axis=(0, 1)) - low) / voxel).astype(np.int64) - 1
    first = np.clip(first, 0, last)
    last = np.clip(np.floor((corners.max(axis=(0, 1)) - low) / voxel).astype(np.int64) + 1, first, last)
    finest = np.zeros(tuple(last - first + 1), np.float32)
    _mark(means, np.ascontiguousarray(points.sizes, dtype=np.float32), low, first, voxel, finest)
    return finest, low, first


@kernel
def _mark(means, sizes, low, first, voxel, finest):
    """Note in every voxel the size of the finest Gaussian in it, below or above it; 0 = none. ``means`` is [3, M]."""
    for n in range(len(sizes)):
        i = int((means[0, n] - low[0]) / voxel) - first[0]
        j = int((means[1, n] - low[1]) / voxel) - first[1]
        k = int((means[2, n] - low[2]) / voxel) - first[2]
        if 0 <= i < finest.shape[0] and 0 <= j < finest.shape[1]:
            for z in range(max(k - 1, 0), min(k + 2, finest.shape[2])):
                if finest[i, j, z] == 0.0 or sizes[n] < finest[i, j, z]:
                    finest[i, j, z] = sizes[n]


@kernel
def _coarse_tiles(
    seen, starts, shapes, lows, frames, cell, finest, low, first, largest, tile, least, found, planes
):  # fmt: skip
    """Centre (world), number of coarse cells and mean size there of every tile that counts; returns how many.

    Written to ``found`` [T, 5], the index of the grid to ``planes`` [T].
    """
    voxel = _VOXEL * cell
    count = 0
    # Voxels of a tile's cells; sizes are asked for only where the tile counts, which is rare.
    indices = np.empty((tile * tile, 3), np.int64)
    for n in range(len(frames)):
        frame = frames[n]
        rows, columns = shapes[n]
        for top in range(0, rows, tile):
            for left in range(0, columns, tile):
                cells, coarse, row_sum, column_sum = 0, 0, 0.0, 0.0
                for row in range(top, min(top + tile, rows)):
                    for column in range(left, min(left + tile, columns)):
                        if seen[starts[n] + row * columns + column] == 0:
                            continue
                        a, b = (lows[n, 0] + row + 0.5) * cell, (lows[n, 1] + column + 0.5) * cell
                        i = int(np.floor((frame[0] + a * frame[3] + b * frame[6] - low[0]) / voxel)) - first[0]
                        j = int(np.floor((frame[1] + a * frame[4] + b * frame[7] - low[1]) / voxel)) - first[1]
                        k = int(np.floor((frame[2] + a * frame[5] + b * frame[8] - low[2]) / voxel)) - first[2]
                        indices[cells, 0], indices[cells, 1], indices[cells, 2] = i, j, k
                        cells += 1
                        fine = False
                        if 0 <= k < finest.shape[2]:
                            if 0 <= i < finest.shape[0] and 0 <= j < finest.shape[1]:
                                fine = 0.0 < finest[i, j, k] <= largest  # the usual case
                            if not fine:
                                for x in range(max(i - 1, 0), min(i + 2, finest.shape[0])):
                                    for y in range(max(j - 1, 0), min(j + 2, finest.shape[1])):
                                        fine = fine or 0.0 < finest[x, y, k] <= largest
                        if not fine:
                            coarse += 1
                            row_sum += row
                            column_sum += column
                if coarse < least:
                    continue
                sized, size_sum = 0, 0.0
                for m in range(cells):
                    best = _finest(finest, indices[m, 0], indices[m, 1], indices[m, 2])
                    if best > 0.0:
                        sized += 1
                        size_sum += best
                a = (row_sum / coarse + lows[n, 0] + 0.5) * cell
                b = (column_sum / coarse + lows[n, 1] + 0.5) * cell
                for axis in range(3):
                    found[count, axis] = frame[axis] + (a * frame[3 + axis] + b * frame[6 + axis])
                found[count, 3] = coarse
                found[count, 4] = size_sum / sized if sized else 2.0 * largest
                planes[count] = n
                count += 1
    return count


@kernel
def _finest(finest, i, j, k):
    """Size of the finest Gaussian in voxel (i, j, k) and its neighbours; 0 = none."""
    best = 0.0
    if 0 <= k < finest.shape[2]:
        for x in range(max(i - 1, 0), min(i + 2, finest.shape[0])):
            for y in range(max(j - 1, 0), min(j + 2, finest.shape[1])):
                here = finest[x, y, k]
                if here > 0.0 and (best == 0.0 or here < best):
                    best = here
    return best
