"""Find sparse patches: seen cells of a plane on which the map's Gaussians are coarser than the cells.

Eq. 6 tests which cells of a plane contain reconstructed points. A wall seen from far away has depth in every cell but
few Gaussians. Its rendered images look complete only from the poses from which it was seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.planes.nodes import PlaneNode
from activestructure_gym.planes.surface import GridStack, stack_grids

# Side of a voxel / side of a cell. Points in the same or in adjacent voxels are at most about one cell apart.
_VOXEL = 0.7
_CENTRES = 62  # voxels per word of 64 bits; the other two bits are the neighbours at both ends
_CORNERS = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])  # of a rectangle, as fractions of its sides


@dataclass(frozen=True)
class MapPoints:
    """Hold centres and sizes of the map's Gaussians, as input of the Plane Scene Graph."""

    means: np.ndarray  # [M, 3] metres, world
    sizes: np.ndarray  # [M] metres, middle of the three standard deviations: the smaller in-plane one of a disk

    @classmethod
    def from_log_scales(cls, means: np.ndarray, log_scales: np.ndarray) -> MapPoints:
        """Return `MapPoints` from the map's arrays ``means`` [3, M] in metres and ``log_scales`` [3, M]."""
        a, b, c = log_scales
        # Copied, since the patches may be computed after the map has changed.
        return cls(means.copy().T, np.exp(np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))))


@dataclass(frozen=True)
class SparsePatches:
    """Hold D square patches of planes on which the map is too coarse."""

    centres: np.ndarray  # [D, 3] metres, world
    areas: np.ndarray  # [D] m^2, area of the coarse cells
    sizes: np.ndarray  # [D] metres, size of the finest Gaussian near a coarse cell, as a mean over these cells
    planes: np.ndarray  # [D] int64 index of the plane


def sparse_patches(
    nodes: Sequence[PlaneNode],
    points: MapPoints,
    *,
    tile: int,  # side of a patch, cells
    least_cells: int,  # fewest coarse cells of a patch
    largest: float,  # metres; a cell is fine if a Gaussian of at most this size is within about one cell
) -> SparsePatches:
    """Return the patches of planes with enough seen cells that have no fine Gaussian nearby.

    A cell without any Gaussian nearby counts as a cell with a Gaussian of size ``2 * largest``. For an empty map, all
    seen patches are returned.
    """
    surfaces = [node.surface for node in nodes]
    if not surfaces:
        return SparsePatches(np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.zeros(0, np.int64))
    grids, cell = stack_grids(surfaces), surfaces[0].cell
    voxels = _voxels_around(grids, points, cell, largest)
    tiles = (-(-grids.shapes // tile)).prod(axis=1).sum()
    found, planes = np.empty((tiles, 5)), np.empty(tiles, np.int64)
    cells = _Cells(
        np.concatenate([surface.seen.ravel() for surface in surfaces]),
        grids.starts, grids.shapes, grids.lows, grids.frames, cell,
    )  # fmt: skip
    count = _coarse_tiles(cells, voxels, largest, tile, least_cells, found, planes)
    return SparsePatches(found[:count, :3], found[:count, 3] * cell**2, found[:count, 4], planes[:count])


class _Cells(NamedTuple):
    """Hold the cells of the grids of all planes, see `GridStack`."""

    seen: np.ndarray  # [sum of R * C] uint8, all grids in one flat array
    starts: np.ndarray
    shapes: np.ndarray
    lows: np.ndarray
    frames: np.ndarray
    cell: float  # metres


class _Voxels(NamedTuple):
    """Hold bit masks of the voxels that contain Gaussians around the planes, each [X + 4, Y + 4, W] uint64."""

    low: np.ndarray  # [3] metres, world: corner of voxel (0, 0, 0)
    box: np.ndarray  # [2, 3] first stored voxel, number of stored voxels
    held: np.ndarray  # voxels that contain a Gaussian
    close: np.ndarray  # voxels that contain a Gaussian or have a neighbour that does
    near: np.ndarray  # the same for fine Gaussians
    ranks: np.ndarray  # per word, number of bits set in all earlier words of ``held``
    finest: np.ndarray  # size of the finest Gaussian in metres, per bit set in ``held``


def _voxels_around(
    grids: GridStack,
    points: MapPoints,
    cell: float,
    largest: float,  # metres
) -> _Voxels:
    """Return the voxels around the planes that contain Gaussians, as bit masks small enough for the processor's cache.

    Voxel indices start at the lowest Gaussian, but only voxels around the planes are stored, so distant Gaussians need
    no memory. A Gaussian is fine up to the size ``largest``.
    """
    voxel = _VOXEL * cell
    means = np.ascontiguousarray(np.asarray(points.means).T, dtype=np.float32)  # [3, M]
    if not len(points.means):
        low, box = np.zeros(3), np.array([[0, 0, 0], [1, 1, 1]])
    else:
        low = means.min(axis=1).astype(np.float64) - 2 * voxel
        last = np.ceil((means.max(axis=1) - low) / voxel).astype(np.int64) + 2
        corner = (grids.lows[:, None] + _CORNERS * grids.shapes[:, None]) * cell  # [N, 4, 2]
        corners = grids.frames[:, None, :3] + corner @ grids.frames[:, 3:9].reshape(-1, 2, 3)  # [N, 4, 3] world
        first = np.floor((corners.min(axis=(0, 1)) - low) / voxel).astype(np.int64) - 1
        first = np.clip(first, 0, last)
        last = np.clip(np.floor((corners.max(axis=(0, 1)) - low) / voxel).astype(np.int64) + 1, first, last)
        box = np.stack([first, last - first + 1])
    shape = (box[1, 0] + 4, box[1, 1] + 4, -(-box[1, 2] // _CENTRES))
    # One allocation, whose memory the allocator can reuse.
    held, fine, close, near, scratch = np.empty((5, *shape), np.uint64)
    held[:], fine[:], scratch[:] = 0, 0, 0
    place = np.empty(means.shape[1], np.int64)
    sizes = np.ascontiguousarray(points.sizes, dtype=np.float32)
    _mark(means, sizes, (low, box, voxel), largest, held, fine, place)
    _spread(held, scratch, close)
    _spread(fine, scratch, near)
    ranks, finest = _rank(held, place, sizes)
    return _Voxels(low, box, held, close, near, ranks, finest)


@kernel
def _mark(means, sizes, lattice, largest, held, fine, place):
    """Set the bits of the voxels that contain Gaussians, with ``means`` [3, M] and ``sizes`` [M] in metres.

    ``held`` and ``fine`` are the masks of all and of fine Gaussians. A word has the bits of 62 voxels along z, and at
    its ends those of the previous and the next voxel. So the z neighbours of a voxel are in the same word. In x and y
    there are two empty voxels on each side. Writes to ``place`` [M] the word of each Gaussian times 64 plus its bit, -1
    outside. ``lattice`` holds the corner of voxel (0, 0, 0), the first voxel and the number of voxels, and the voxel
    size. Gaussians of a size up to ``largest`` are fine.
    """
    low, box, voxel = lattice
    words = held.shape[2]
    held_words, fine_words = held.reshape(held.size), fine.reshape(fine.size)
    for n in range(len(sizes)):
        place[n] = -1
        i = int((means[0, n] - low[0]) / voxel) - box[0, 0]
        j = int((means[1, n] - low[1]) / voxel) - box[0, 1]
        k = int((means[2, n] - low[2]) / voxel) - box[0, 2]
        if not (0 <= i < box[1, 0] and 0 <= j < box[1, 1] and -1 <= k <= box[1, 2]):
            continue
        part = min(max(k, 0) // _CENTRES, words - 1)
        word, bit = ((i + 2) * held.shape[1] + j + 2) * words + part, k - part * _CENTRES + 1
        place[n] = 64 * word + bit
        # A voxel at the end of its word is also stored as a neighbour in the adjacent word.
        for side in range(-1, 2):
            other = bit - side * _CENTRES
            if side == 0 or (0 <= other < 64 and 0 <= part + side < words):
                mask = np.uint64(1) << np.uint64(other)
                held_words[word + side] |= mask
                if sizes[n] <= largest:
                    fine_words[word + side] |= mask


@kernel
def _spread(bits, scratch, wide):
    """Write the mask of voxels ``bits`` to ``wide``, dilated by one voxel along each axis; ``scratch`` is workspace.

    The outermost words of ``wide`` are undefined.
    """
    words, row = bits.shape[2], bits.shape[1] * bits.shape[2]
    flat, across, result = bits.reshape(bits.size), scratch.reshape(bits.size), wide.reshape(bits.size)[row:]
    # Slices with an offset are used, because indices that may be negative would prevent vectorisation.
    before, behind, middle = flat[words:], flat[2 * words :], across[words:]
    for q in range(len(behind)):
        middle[q] = flat[q] | before[q] | behind[q]
    before, behind = across[row:], across[2 * row :]
    one = np.uint64(1)
    for q in range(len(behind)):
        word = across[q] | before[q] | behind[q]
        result[q] = word | word << one | word >> one


@kernel
def _rank(held, place, sizes):
    """Return the number of bits set in ``held`` before each word, and the finest Gaussian's size for each bit set.

    ``place`` [M] is described at `_mark`; ``sizes`` [M] are in metres.
    """
    words = held.shape[2]
    flat = held.reshape(held.size)
    ranks = np.empty(len(flat), np.int32)
    total = 0
    for q in range(len(flat)):
        ranks[q] = total
        total += _bits(flat[q])
    finest = np.full(total, np.inf, np.float32)
    for n in range(len(sizes)):
        if place[n] < 0:
            continue
        word, bit = place[n] >> 6, place[n] & 63
        part = word % words
        for side in range(-1, 2):
            other = bit - side * _CENTRES
            if side == 0 or (0 <= other < 64 and 0 <= part + side < words):
                below = (np.uint64(1) << np.uint64(other)) - np.uint64(1)
                rank = np.int64(ranks[word + side]) + _bits(flat[word + side] & below)
                finest[rank] = min(finest[rank], sizes[n])
    return ranks, finest


@kernel
def _bits(word):
    """Return the number of set bits of a 64-bit word."""
    word -= word >> np.uint64(1) & np.uint64(0x5555555555555555)
    word = (word & np.uint64(0x3333333333333333)) + (word >> np.uint64(2) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64(word * np.uint64(0x0101010101010101) >> np.uint64(56))


@kernel
def _coarse_tiles(cells_of_all, voxels, largest, tile, least, found, planes):
    """Find the coarse tiles of all planes; return their number.

    Writes world centre [3], number of coarse cells and mean size of the finest Gaussians to ``found`` [T, 5], and the
    index of the plane to ``planes`` [T]. ``tile`` is the side of a tile in cells, and ``least`` its fewest coarse
    cells. ``cells_of_all`` are the cells of all planes and ``voxels`` the voxels with Gaussians. A Gaussian is fine up
    to the size ``largest`` in metres.
    """
    seen, starts, shapes, lows, frames, cell = cells_of_all
    low, box, held, close, near, ranks, finest = voxels
    voxel = _VOXEL * cell
    words, row_words = held.shape[2], held.shape[1] * held.shape[2]
    held_words, close_words, near_words = held.reshape(held.size), close.reshape(held.size), near.reshape(held.size)
    one, three_bits = np.uint64(1), np.uint64(7)
    count = 0
    # Words and bits of the cells of a tile with only coarse Gaussians nearby. Their sizes are read only for coarse
    # tiles.
    places = np.empty(tile * tile, np.int64)
    for n in range(len(frames)):
        frame = frames[n]
        rows, columns = shapes[n]
        for top in range(0, rows, tile):
            for left in range(0, columns, tile):
                wide, coarse, row_sum, column_sum = 0, 0, 0.0, 0.0
                for row in range(top, min(top + tile, rows)):
                    a = (lows[n, 0] + row + 0.5) * cell
                    x, y, z = frame[0] + a * frame[3], frame[1] + a * frame[4], frame[2] + a * frame[5]
                    for column in range(left, min(left + tile, columns)):
                        if seen[starts[n] + row * columns + column] == 0:
                            continue
                        b = (lows[n, 1] + column + 0.5) * cell
                        i = int(np.floor((x + b * frame[6] - low[0]) / voxel)) - box[0, 0]
                        j = int(np.floor((y + b * frame[7] - low[1]) / voxel)) - box[0, 1]
                        k = int(np.floor((z + b * frame[8] - low[2]) / voxel)) - box[0, 2]
                        if -1 <= i <= box[1, 0] and -1 <= j <= box[1, 1] and 0 <= k < box[1, 2]:
                            part = k // _CENTRES
                            word, bit = (i + 2) * row_words + (j + 2) * words + part, k - part * _CENTRES + 1
                            if close_words[word] >> np.uint64(bit) & one != 0:
                                if near_words[word] >> np.uint64(bit) & one != 0:
                                    continue
                                places[wide] = 64 * word + bit
                                wide += 1
                        coarse += 1
                        row_sum += row
                        column_sum += column
                if coarse < max(least, 1):
                    continue
                size_sum = 2.0 * largest * (coarse - wide)  # cells without any Gaussian nearby
                for m in range(wide):
                    word, before = places[m] >> 6, np.uint64((places[m] & 63) - 1)
                    below = (one << before) - one
                    best = np.float32(np.inf)
                    for beside in range(word - row_words, word + row_words + 1, row_words):
                        for column in range(beside - words, beside + words + 1, words):
                            around = held_words[column] >> before & three_bits
                            if around != 0:
                                rank = np.int64(ranks[column]) + _bits(held_words[column] & below)
                                for _ in range(_bits(around)):
                                    best = min(best, finest[rank])
                                    rank += 1
                    size_sum += float(best)
                a = (row_sum / coarse + lows[n, 0] + 0.5) * cell
                b = (column_sum / coarse + lows[n, 1] + 0.5) * cell
                for axis in range(3):
                    found[count, axis] = frame[axis] + (a * frame[3 + axis] + b * frame[6 + axis])
                found[count, 3] = coarse
                found[count, 4] = size_sum / coarse
                planes[count] = n
                count += 1
    return count
