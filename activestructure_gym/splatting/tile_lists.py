"""Build the lists of Gaussians per tile: count the entries of every tile, reserve their positions, fill and sort them.

An entry is a pair of tile and Gaussian. ``base`` is the offset of a Gaussian's record in ``records``.
"""

# mypy: ignore-errors
# (the arguments of kernels have numba's types, and intrinsics are called without their typing context)

from __future__ import annotations

import numpy as np

from activestructure_gym.splatting.layout import (
    BITMAP,
    BOX_X,
    BOX_Y,
    CHUNK,
    COUNT,
    DEPTH,
    KEY,
    KEY_2,
    L00,
    L01,
    L11,
    LOG2_255,
    LOG_OPACITY,
    PLACES,
    REACH,
    RECORD,
    SLACK,
    SLOT,
    SLOTS,
    SORTED_REACH,
    SORTED_SPLAT,
    SPLAT_KEY,
    TILE,
    TILES_X,
    TILES_Y,
    U,
    V,
)
from activestructure_gym.splatting.memory import count_bits, lowest_bit, peek, peek_bits, poke, poke_add, poke_bits
from activestructure_gym.splatting.projection import project_block
from activestructure_gym.splatting.simd import LANES, U64, F, inline, inner

# Bytes with the lowest 8 - shift bits set: columns of blocks that remain in a tile after a shift.
_COLUMNS_KEPT = np.array([0x0101010101010101 * (0xFF >> shift) for shift in range(8)], np.uint64)


@inner
def _reach_of_large(records, base, tile_x, tile_y, last_x):
    """Return the blocks of tile (tile_x, tile_y) that an ellipse larger than 8 x 8 blocks touches, as 64 bits.

    This is a scalar version of the bitmap in `projection`. ``last_x`` is the last column of blocks in the image.
    """
    u, v = peek(records, base + U), peek(records, base + V)
    l00, l01, l11 = peek(records, base + L00), peek(records, base + L01), peek(records, base + L11)
    inside = peek(records, base + LOG_OPACITY) + LOG2_255
    root = np.sqrt(max(inside, F(0.0)))
    radius_y = root / l11 + SLACK
    width = np.sqrt(l01 * l01 + l11 * l11)
    turning = -l01 * root / (l11 * width)
    reach = U64(0)
    for band in range(8):
        top = F(4 * (8 * tile_y + band)) + F(0.5) - v
        from_y, to_y = max(top, -radius_y), min(top + F(3.0), radius_y)
        if from_y > to_y:
            continue
        at = min(max(turning, from_y), to_y)
        right = u - l01 / l00 * at + np.sqrt(max(inside - l11 * at * l11 * at, F(0.0))) / l00 + SLACK
        at = min(max(-turning, from_y), to_y)
        left = u - l01 / l00 * at - np.sqrt(max(inside - l11 * at * l11 * at, F(0.0))) / l00 - SLACK
        origin = F(TILE * tile_x)
        first = np.int64(max(np.ceil((max(left - origin, F(-1e6)) - F(3.5)) * F(0.25)), F(0.0)))
        last = np.int64(min(np.floor((min(right - origin, F(1e6)) - F(0.5)) * F(0.25)), F(min(7, last_x - 8 * tile_x))))
        if first <= last:
            reach |= U64((2 << last) - (1 << first)) << U64(8 * band)
    return reach


@inline
def _reach(records, base, x0, y0, x1, y1, tile_x, tile_y):
    """Return the blocks of tile (tile_x, tile_y) that a Gaussian reaches, as 64 bits.

    They are the bitmap of its bounding box, shifted to the corner of the tile. (x0, y0) and (x1, y1) are the first and
    the last block of the box.
    """
    if x1 - x0 > 7 or y1 - y0 > 7:
        return _reach_of_large(records, base, tile_x, tile_y, x1)
    reach = U64(peek_bits(records, base + BITMAP)) | (U64(peek_bits(records, base + BITMAP + 1)) << U64(32))
    x, y = x0 - 8 * tile_x, y0 - 8 * tile_y
    if y >= 0:
        reach = reach << U64(8 * y)
    else:
        reach = reach >> U64(-8 * y)
    if x >= 0:
        return (reach & peek(_COLUMNS_KEPT, x)) << U64(x)
    return (reach >> U64(-x)) & peek(_COLUMNS_KEPT, -x)


@inline
def _box(records, base):
    x, y = peek_bits(records, base + BOX_X), peek_bits(records, base + BOX_Y)
    return x & 0xFFFF, y & 0xFFFF, x >> 16, y >> 16


@inline
def _one_tile(x0, y0, x1, y1):
    """Return whether a bounding box of blocks, from (x0, y0) to (x1, y1), is in one tile.

    Most boxes are. Their blocks need not be tested when entries are counted.
    """
    return ((x0 ^ x1) | (y0 ^ y1)) < 8


@inner
def project_chunk(number, parameters, lists, histogram, chunk_entries):
    """Project the 1024 Gaussians of chunk ``lists.taken[number]``, and count their entries per tile."""
    view, grid, records, visible = lists.camera, lists.grid, lists.records, lists.visible
    tiles_x = grid[TILES_X]
    tiles = tiles_x * grid[TILES_Y]
    for tile in range(tiles):
        poke(histogram, number * tiles + tile, np.int32(0))
    entries, chunk = 0, lists.taken[number]
    for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, grid[COUNT]), LANES):
        seen = project_block(parameters, i, view, grid, records)
        poke(visible, i // LANES, np.int32(seen))
        while seen != 0:
            base = RECORD * (i + lowest_bit(seen))
            seen &= seen - 1
            x0, y0, x1, y1 = _box(records, base)
            alone = _one_tile(x0, y0, x1, y1)
            for tile_y in range(y0 >> 3, (y1 >> 3) + 1):
                for tile_x in range(x0 >> 3, (x1 >> 3) + 1):
                    if alone or _reach(records, base, x0, y0, x1, y1, tile_x, tile_y) != U64(0):
                        at = number * tiles + tile_y * tiles_x + tile_x
                        poke(histogram, at, peek(histogram, at) + np.int32(1))
                        entries += 1
    chunk_entries[number] = entries


@inner
def _order_tiles(tiles, tile_start, tile_order):
    """Sort the tiles by decreasing number of entries, in 256 steps, with ties by index (counting sort).

    ``tile_start`` [tiles + 1] gives the entries of each tile. The order is written to ``tile_order``.
    """
    most = 1
    for rank in range(PLACES):
        poke(tile_order, tiles + rank, 0)
    for tile in range(tiles):
        most = max(most, tile_start[tile + 1] - tile_start[tile])
    for tile in range(tiles):
        poke_add(tile_order, tiles + 257 - 256 * (tile_start[tile + 1] - tile_start[tile]) // most, 1)
    for rank in range(1, PLACES):
        poke_add(tile_order, tiles + rank, peek(tile_order, tiles + rank - 1))
    for tile in range(tiles):
        place = tiles + 256 - 256 * (tile_start[tile + 1] - tile_start[tile]) // most
        poke(tile_order, peek(tile_order, place), tile)
        poke_add(tile_order, place, 1)


@inner
def plan_entries(lists, histogram, chunk_entries):
    """Convert numbers of entries to start positions of each chunk's entries in each tile, and of its slots.

    ``tile_order`` lists the tiles with most entries first, so that all threads end at nearly the same time. Returns the
    number of entries.
    """
    grid, tile_start = lists.grid, lists.tile_start
    tiles, chunks = grid[TILES_X] * grid[TILES_Y], len(lists.taken)
    for tile in range(tiles + 1):
        tile_start[tile] = 0
    for chunk in range(chunks):
        if chunk_entries[chunk] == 0:  # the chunk is out of view
            continue
        for tile in range(tiles):
            poke_add(tile_start, tile, np.int64(peek(histogram, chunk * tiles + tile)))
    total = 0
    for tile in range(tiles + 1):
        entries = tile_start[tile]
        tile_start[tile] = total
        total += entries
    for chunk in range(chunks):
        if chunk_entries[chunk] == 0:
            continue
        for tile in range(tiles):
            entries = np.int64(peek(histogram, chunk * tiles + tile))
            poke(histogram, chunk * tiles + tile, np.int32(peek(tile_start, tile)))
            poke_add(tile_start, tile, entries)
    for tile in range(tiles, 0, -1):  # the loop above has moved each start to the start of the next tile
        tile_start[tile] = tile_start[tile - 1]
    tile_start[0] = 0
    slots = 0
    for chunk in range(chunks):
        entries = chunk_entries[chunk]
        chunk_entries[chunk] = slots
        slots += entries
    _order_tiles(tiles, tile_start, lists.tile_order)
    return total


@inner
def fill_chunk(number, lists, histogram, chunk_entries):
    """Write the entries of the 1024 Gaussians of chunk ``lists.taken[number]``.

    Each entry has a slot, to which the backward pass writes its gradients. The slots of one Gaussian are consecutive.
    """
    grid, records, visible, entries = lists.grid, lists.records, lists.visible, lists.entries
    tiles_x = grid[TILES_X]
    tiles, room = tiles_x * grid[TILES_Y], entries.shape[1]
    slot, chunk = chunk_entries[number], lists.taken[number]
    for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, grid[COUNT]), LANES):
        seen = np.int64(peek(visible, i // LANES))
        while seen != 0:
            splat = i + lowest_bit(seen)
            base = RECORD * splat
            seen &= seen - 1
            depth = U64(peek_bits(records, base + DEPTH)) << U64(32)
            x0, y0, x1, y1 = _box(records, base)
            poke_bits(records, base + SLOT, slot)
            first, alone = slot, _one_tile(x0, y0, x1, y1)
            for tile_y in range(y0 >> 3, (y1 >> 3) + 1):
                for tile_x in range(x0 >> 3, (x1 >> 3) + 1):
                    reach = _reach(records, base, x0, y0, x1, y1, tile_x, tile_y)
                    if alone or reach != U64(0):  # the same rule as for counting
                        counter = number * tiles + tile_y * tiles_x + tile_x
                        at = np.int64(peek(histogram, counter))
                        poke(histogram, counter, np.int32(at + 1))
                        poke(entries, KEY * room + at, depth | U64(at))
                        poke(entries, REACH * room + at, reach)
                        poke(entries, SPLAT_KEY * room + at, U64(splat) | (U64(slot) << U64(32)))
                        slot += 1
            poke_bits(records, base + SLOTS, slot - first)


@inner
def sort_tile(tile, lists, digits):
    """Sort the entries of a tile by depth, with ties by index; return the total number of blocks that they reach.

    It is a radix sort of the bits of the depths, since positive floats have the order of their bits.
    """
    start, stop, entries = lists.tile_start[tile], lists.tile_start[tile + 1], lists.entries
    room = entries.shape[1]
    source, target = KEY * room, KEY_2 * room
    count = stop - start
    if count <= 32:
        for i in range(start + 1, stop):
            key = peek(entries, source + i)
            j = i - 1
            while j >= start and peek(entries, source + j) > key:
                poke(entries, source + j + 1, peek(entries, source + j))
                j -= 1
            poke(entries, source + j + 1, key)
    else:
        nearest = farthest = peek(entries, source + start)
        for i in range(start, stop):
            key = peek(entries, source + i)
            nearest, farthest = min(nearest, key), max(farthest, key)
        # Only the bits in which depths of this tile can differ from the nearest depth are sorted.
        nearest = nearest >> U64(32)
        spare, width = (farthest >> U64(32)) - nearest, 0
        while (spare >> U64(width)) != U64(0):
            width += 1
        most = 8 if count < 2048 else 11  # bits of a digit; a larger table of digits takes longer to traverse
        rounds = (width + most - 1) // most
        width = (width + rounds - 1) // max(rounds, 1)
        shift, size = 0, 1 << width
        low = U64(size - 1)
        for _ in range(rounds):
            for digit in range(size):
                poke(digits, digit, np.int64(0))
            for i in range(start, stop):
                digit = np.int64((((peek(entries, source + i) >> U64(32)) - nearest) >> U64(shift)) & low)
                poke(digits, digit, peek(digits, digit) + 1)
            place = start
            for digit in range(size):
                own = peek(digits, digit)
                poke(digits, digit, place)
                place += own
            for i in range(start, stop):
                key = peek(entries, source + i)
                digit = np.int64((((key >> U64(32)) - nearest) >> U64(shift)) & low)
                place = peek(digits, digit)
                poke(digits, digit, place + 1)
                poke(entries, target + place, key)
            source, target = target, source
            shift += width
    blocks = 0
    for i in range(start, stop):
        at = np.int64(peek(entries, source + i) & U64(0xFFFFFFFF))
        reach = peek(entries, REACH * room + at)
        blocks += count_bits(reach)
        poke(entries, SORTED_REACH * room + i, reach)
        poke(entries, SORTED_SPLAT * room + i, peek(entries, SPLAT_KEY * room + at))
    return blocks
