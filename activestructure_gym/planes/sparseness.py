"""Where a plane was seen but the map is thinner than the plane's own grid.

Eq. 6 asks which cells of a plane are occupied by reconstructed points. A wall seen from far away has depth in every
cell and Gaussians in few of them; the pixels it fills look covered from wherever it was seen.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.planes.nodes import PlaneNode

_VOXEL = 0.7  # of a cell: a point in the same or a neighbouring voxel lies within about one cell
_BUFFER = 4096  # tiles of one plane: 32 m x 32 m of half metres


def sparse_patches(
    nodes: Sequence[PlaneNode],
    map_points: np.ndarray,  # [M, 3] metres, world: centres of the Gaussians
    *,
    tile: int,  # cells along the edge of a patch
    least_cells: int,  # without a point near, for a patch to count
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # centres [D, 3], areas [D] m^2 without a point, plane index [D]
    """Square patches of planes in which seen cells have no point of the map within about a cell."""
    centres, areas, owner = [np.zeros((0, 3))], [np.zeros(0)], [np.zeros(0, np.int64)]
    if nodes:
        size = _VOXEL * nodes[0].surface.cell
        points = np.ascontiguousarray(map_points, dtype=np.float32).reshape(-1, 3)
        low = (points.min(axis=0) if len(points) else np.zeros(3)).astype(np.float64) - 2 * size
        high = points.max(axis=0) if len(points) else np.zeros(3)
        shape = np.ceil((high - low) / size).astype(np.int64) + 3
        filled = np.zeros(tuple(shape), np.uint8)
        _mark(points, low, size, filled)
        found = np.empty((_BUFFER, 3), np.float64)
        for k, node in enumerate(nodes):
            surface = node.surface
            count = _sparse_tiles(surface.seen, surface.low, surface.frame, surface.cell, filled, low, size, tile,
                                  least_cells, found)  # fmt: skip
            if count:
                own = found[:count]
                centres.append(surface.cell_centres(own[:, 0], own[:, 1]))
                areas.append(own[:, 2] * surface.cell**2)
                owner.append(np.full(count, k, np.int64))
    return np.concatenate(centres), np.concatenate(areas), np.concatenate(owner)


@kernel
def _mark(points, low, size, filled):
    """Fill the voxels that hold a point."""
    for n in range(len(points)):
        i, j, k = int((points[n, 0] - low[0]) / size), int((points[n, 1] - low[1]) / size), int(
            (points[n, 2] - low[2]) / size
        )
        filled[i, j, k] = 1


@kernel
def _sparse_tiles(seen, first, frame, cell, filled, low, size, tile, least, found):
    """Mean row, mean column (array cells) and number of the cells without a point, per tile; returns how many."""
    rows, columns = seen.shape
    count = 0
    for top in range(0, rows, tile):
        for left in range(0, columns, tile):
            bare, row_sum, column_sum = 0, 0.0, 0.0
            for row in range(top, min(top + tile, rows)):
                for column in range(left, min(left + tile, columns)):
                    if seen[row, column] == 0:
                        continue
                    a, b = (first[0] + row + 0.5) * cell, (first[1] + column + 0.5) * cell
                    i = int(np.floor((frame[0] + a * frame[3] + b * frame[6] - low[0]) / size))
                    j = int(np.floor((frame[1] + a * frame[4] + b * frame[7] - low[1]) / size))
                    k = int(np.floor((frame[2] + a * frame[5] + b * frame[8] - low[2]) / size))
                    near = False
                    if i >= 1 and j >= 1 and k >= 1:
                        if i + 1 < filled.shape[0] and j + 1 < filled.shape[1] and k + 1 < filled.shape[2]:
                            for x in range(i - 1, i + 2):
                                for y in range(j - 1, j + 2):
                                    for z in range(k - 1, k + 2):
                                        if filled[x, y, z]:
                                            near = True
                    if not near:
                        bare += 1
                        row_sum += row
                        column_sum += column
            if bare >= least and count < len(found):
                found[count, 0], found[count, 1], found[count, 2] = row_sum / bare, column_sum / bare, bare
                count += 1
    return count
