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
from activestructure_gym.planes.surface import SurfaceGrid

_VOXEL = 0.7  # of a cell: a point in the same or a neighbouring voxel lies within about one cell


@dataclass(frozen=True)
class MapPoints:
    """What the Plane Scene Graph knows of the map: where its Gaussians are and how large."""

    means: np.ndarray  # [M, 3] metres, world
    sizes: np.ndarray  # [M] metres, middle one of the three standard deviations: the short one in the plane of a disk


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
    found: list[np.ndarray] = [np.zeros((0, 7))]
    surfaces = [node.surface for node in nodes if node.surface.seen.size]
    if surfaces:
        finest, low, first, voxel = _finest_near(surfaces, points)
        most = max(-(-surface.seen.shape[0] // tile) * -(-surface.seen.shape[1] // tile) for surface in surfaces)
        buffer = np.empty((most, 4), np.float64)
        for k, node in enumerate(nodes):
            surface = node.surface
            count = _coarse_tiles(
                surface.seen, surface.low, surface.frame, surface.cell, finest, low, first, voxel, largest, tile,
                least_cells, buffer,
            )  # fmt: skip
            if count:
                own = buffer[:count]
                centres = surface.cell_centres(own[:, 0], own[:, 1])
                rest = np.stack([own[:, 2] * surface.cell**2, own[:, 3], np.full(count, k), own[:, 2]], axis=1)
                found.append(np.concatenate([centres, rest], axis=1))
    table = np.concatenate(found)
    return SparsePatches(table[:, :3], table[:, 3], table[:, 4], table[:, 5].astype(np.int64))


def _finest_near(
    surfaces: Sequence[SurfaceGrid], points: MapPoints
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:  # [X, Y, Z] float32 metres, [3] metres, [3] int64, metres
    """The finest Gaussian of every voxel and its two neighbours in z, with what `_coarse_tiles` needs to find a voxel.

    Voxels are counted from the lowest Gaussian but stored only around the planes: one Gaussian that strayed far off
    must not ask for a grid that reaches as far.
    """
    voxel = _VOXEL * surfaces[0].cell
    if not len(points.means):
        return np.zeros((1, 1, 1), np.float32), np.zeros(3), np.zeros(3, np.int64), voxel
    means = np.ascontiguousarray(np.asarray(points.means).T, dtype=np.float32)  # [3, M]
    low = means.min(axis=1).astype(np.float64) - 2 * voxel
    last = np.ceil((means.max(axis=1) - low) / voxel).astype(np.int64) + 2
    corners = np.concatenate([surface.corners for surface in surfaces])
    first = np.clip(np.floor((corners.min(axis=0) - low) / voxel).astype(np.int64) - 1, 0, last)
    last = np.clip(np.floor((corners.max(axis=0) - low) / voxel).astype(np.int64) + 1, first, last)
    finest = np.zeros(tuple(last - first + 1), np.float32)
    _mark(means, np.ascontiguousarray(points.sizes, dtype=np.float32), low, first, voxel, finest)
    return finest, low, first, voxel


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
def _coarse_tiles(seen, start, frame, cell, finest, low, first, voxel, largest, tile, least, found):
    """Mean row, mean column (array cells), number of coarse cells and mean size there, per tile; returns how many."""
    rows, columns = seen.shape
    count = 0
    for top in range(0, rows, tile):
        for left in range(0, columns, tile):
            coarse, row_sum, column_sum, sized, size_sum = 0, 0.0, 0.0, 0, 0.0
            for row in range(top, min(top + tile, rows)):
                for column in range(left, min(left + tile, columns)):
                    if seen[row, column] == 0:
                        continue
                    a, b = (start[0] + row + 0.5) * cell, (start[1] + column + 0.5) * cell
                    i = int(np.floor((frame[0] + a * frame[3] + b * frame[6] - low[0]) / voxel)) - first[0]
                    j = int(np.floor((frame[1] + a * frame[4] + b * frame[7] - low[1]) / voxel)) - first[1]
                    k = int(np.floor((frame[2] + a * frame[5] + b * frame[8] - low[2]) / voxel)) - first[2]
                    best = 0.0
                    if 0 <= k < finest.shape[2]:
                        for x in range(max(i - 1, 0), min(i + 2, finest.shape[0])):
                            for y in range(max(j - 1, 0), min(j + 2, finest.shape[1])):
                                here = finest[x, y, k]
                                if here > 0.0 and (best == 0.0 or here < best):
                                    best = here
                    if best > 0.0:
                        sized += 1
                        size_sum += best
                    if best == 0.0 or best > largest:
                        coarse += 1
                        row_sum += row
                        column_sum += column
            if coarse >= least:
                found[count, 0], found[count, 1] = row_sum / coarse, column_sum / coarse
                found[count, 2] = coarse
                found[count, 3] = size_sum / sized if sized else 2.0 * largest
                count += 1
    return count
