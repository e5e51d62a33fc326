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

_VOXEL = 0.7  # of a cell: a point in the same or a neighbouring voxel lies within about one cell
_BUFFER = 4096  # tiles of one plane: 32 m x 32 m of half metres


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
    """Patches in which seen cells have no Gaussian near that is fine enough."""
    found: list[np.ndarray] = [np.zeros((0, 7))]
    if nodes and len(points.means):
        size = _VOXEL * nodes[0].surface.cell
        means = np.ascontiguousarray(points.means, dtype=np.float32)
        low = means.min(axis=0).astype(np.float64) - 2 * size
        shape = np.ceil((means.max(axis=0) - low) / size).astype(np.int64) + 3
        finest = np.zeros(tuple(shape), np.float32)
        _mark(means, np.ascontiguousarray(points.sizes, dtype=np.float32), low, size, finest)
        buffer = np.empty((_BUFFER, 4), np.float64)
        for k, node in enumerate(nodes):
            surface = node.surface
            count = _coarse_tiles(
                surface.seen, surface.low, surface.frame, surface.cell, finest, low, size, largest, tile, least_cells,
                buffer,
            )  # fmt: skip
            if count:
                own = buffer[:count]
                centres = surface.cell_centres(own[:, 0], own[:, 1])
                rest = np.stack([own[:, 2] * surface.cell**2, own[:, 3], np.full(count, k), own[:, 2]], axis=1)
                found.append(np.concatenate([centres, rest], axis=1))
    table = np.concatenate(found)
    return SparsePatches(table[:, :3], table[:, 3], table[:, 4], table[:, 5].astype(np.int64))


@kernel
def _mark(means, sizes, low, voxel, finest):
    """Note in every voxel the size of the finest Gaussian; 0 = none."""
    for n in range(len(means)):
        i, j = int((means[n, 0] - low[0]) / voxel), int((means[n, 1] - low[1]) / voxel)
        k = int((means[n, 2] - low[2]) / voxel)
        if finest[i, j, k] == 0.0 or sizes[n] < finest[i, j, k]:
            finest[i, j, k] = sizes[n]


@kernel
def _coarse_tiles(seen, first, frame, cell, finest, low, voxel, largest, tile, least, found):
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
                    a, b = (first[0] + row + 0.5) * cell, (first[1] + column + 0.5) * cell
                    i = int(np.floor((frame[0] + a * frame[3] + b * frame[6] - low[0]) / voxel))
                    j = int(np.floor((frame[1] + a * frame[4] + b * frame[7] - low[1]) / voxel))
                    k = int(np.floor((frame[2] + a * frame[5] + b * frame[8] - low[2]) / voxel))
                    best = 0.0
                    if i >= 1 and j >= 1 and k >= 1:
                        if i + 1 < finest.shape[0] and j + 1 < finest.shape[1] and k + 1 < finest.shape[2]:
                            for x in range(i - 1, i + 2):
                                for y in range(j - 1, j + 2):
                                    for z in range(k - 1, k + 2):
                                        here = finest[x, y, z]
                                        if here > 0.0 and (best == 0.0 or here < best):
                                            best = here
                    if best > 0.0:
                        sized += 1
                        size_sum += best
                    if best == 0.0 or best > largest:
                        coarse += 1
                        row_sum += row
                        column_sum += column
            if coarse >= least and count < len(found):
                found[count, 0], found[count, 1] = row_sum / coarse, column_sum / coarse
                found[count, 2] = coarse
                found[count, 3] = size_sum / sized if sized else 2.0 * largest
                count += 1
    return count
