"""Run the compiled kernels of the CPU rasteriser, which compute with vectors of 16 floats (SIMD).

The image is cut into tiles of 32 x 32 pixels = 8 x 8 blocks of 4 x 4 pixels. A block is one vector, and the blocks of a
tile that a Gaussian reaches are the bits of one uint64. An entry is a pair of tile and Gaussian. One rendering runs:

- ``prepare``. Per chunk of 1024 Gaussians: 64-byte records (`projection`), bitmaps of blocks and the number of entries.
  In one thread: positions of the entries of every tile and chunk. Per chunk: the entries (`tile_lists`).
- ``blend``. Per tile: sort by depth (exact float order, ties by index), blend front to back (`blending`).
- ``compare``. Per strip of columns: losses, SSIM and the gradient images (`image_losses`).
- ``unblend``. Per tile: front to back again, with one slot of 16 sums per entry. Per chunk: sum the slots, propagate
  the gradient through the projection, take an Adam step or write gradients (`stepping`).

For pixelwise losses (`tile_losses`), ``fuse`` does everything after ``prepare``: blending, comparing and the backward
pass, tile by tile. Between the parts of a kernel, threads wait for each other inside the kernel, since starting them
again takes longer.

Every thread calls the same kernel. Every partial result has a fixed position, so results do not depend on the number of
threads. Chunks, tiles and rows are distributed by the atomic counters ``tickets`` (`counters`).
"""

# mypy: ignore-errors
# (the arguments of kernels have numba's types, and intrinsics are called without their typing context)

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.splatting.blending import (
    COLORED_STATE,
    blend_backward,
    blend_forward,
    open_tile,
    read_tile,
    write_tile,
)
from activestructure_gym.splatting.counters import (
    ENTRIES,
    FILLED,
    KEPT_TICKET,
    PLANNED,
    PROJECTED,
    THREAD_TICKET,
    TILES_DONE,
    all_done,
    take_ticket,
    take_tickets,
)
from activestructure_gym.splatting.image_losses import (
    GROUP_FLOATS,
    GROUP_ROWS,
    PIECE,
    TERMS,
    Around,
    Strip,
    clear,
    compare_depth,
    gradient_of_group,
    maps_of_group,
    means_of_group,
)
from activestructure_gym.splatting.layout import (
    DIGITS,
    HEIGHT,
    SCRATCH,
    TILES_X,
    TILES_Y,
    WIDTH,
)
from activestructure_gym.splatting.memory import load, store
from activestructure_gym.splatting.simd import LANES, F, fma
from activestructure_gym.splatting.stepping import step_parameters
from activestructure_gym.splatting.tile_lists import (
    fill_chunk,
    plan_entries,
    project_chunk,
    sort_tile,
)
from activestructure_gym.splatting.tile_losses import compare_tile


@kernel
def prepare(tickets, parameters, lists, histogram, chunk_entries):
    """Project the Gaussians, count their entries and list them per tile.

    Without enough space for the entries it returns before listing, and continues when called again with more space.
    Counter FILLED then reaches the number n of chunks taken. ``histogram [n * tiles]`` and ``chunk_entries [n]`` are
    workspace for the numbers of entries.
    """
    chunks = len(lists.taken)
    while True:
        chunk = take_ticket(tickets, 0)
        if chunk >= chunks:
            break
        project_chunk(chunk, parameters, lists, histogram, chunk_entries)
        if take_ticket(tickets, PROJECTED) == chunks - 1:  # the last chunk
            tickets[ENTRIES] = plan_entries(lists, histogram, chunk_entries)
            take_ticket(tickets, PLANNED)
    if not all_done(tickets, PLANNED, 1) or tickets[ENTRIES] > lists.entries.shape[1]:
        return
    while True:
        chunk = take_ticket(tickets, 1)
        if chunk >= chunks:
            return
        fill_chunk(chunk, lists, histogram, chunk_entries)
        take_ticket(tickets, FILLED)


@kernel
def blend(tickets, lists, scratch, kept, pictures):
    """Sort, blend and write every tile; store the alphas for `unblend` in ``kept`` while there is space."""
    own = LANES * take_ticket(tickets, THREAD_TICKET) * (SCRATCH // LANES)
    state, digits = scratch[own : own + SCRATCH], np.empty(DIGITS, np.int64)
    grid, tile_order, (alphas, places) = lists.grid, lists.tile_order, kept
    tiles = grid[TILES_X] * grid[TILES_Y]
    while True:
        ticket = take_ticket(tickets, 2)
        if ticket >= tiles:
            return
        tile = tile_order[ticket]
        blocks = sort_tile(tile, lists, digits)
        place = LANES * take_tickets(tickets, KEPT_TICKET, blocks)
        keeps = LANES if place + LANES * blocks <= len(alphas) else 0
        if keeps == 0:
            place = 0
        places[2 * tile] = place if keeps != 0 else -1
        alive = open_tile(tile, grid, state, np.int64(COLORED_STATE))
        keep = alphas[place:] if keeps != 0 else state[SCRATCH - LANES :]
        places[2 * tile + 1] = blend_forward(tile, alive, lists, state, keep, keeps)
        write_tile(tile, grid, state, pictures)


@kernel
def fuse(tickets, lists, scratch, comparison, step):
    """Blend, compare with the target and run the backward pass, tile by tile in the cache; then take a step."""
    own = LANES * take_ticket(tickets, THREAD_TICKET) * (SCRATCH // LANES)
    state, kept = scratch[own : own + 64 * COLORED_STATE], scratch[own + 64 * COLORED_STATE : own + SCRATCH]
    digits, edge = np.empty(DIGITS, np.int64), np.empty(64, np.float32)
    grid, tile_order, slots = lists.grid, lists.tile_order, step.slots
    while True:
        ticket = take_ticket(tickets, 2)
        if ticket >= grid[TILES_X] * grid[TILES_Y]:
            break
        tile = tile_order[ticket]
        blocks = sort_tile(tile, lists, digits)
        keeps = LANES if LANES * blocks <= len(kept) else 0
        alive = open_tile(tile, grid, state, np.int64(COLORED_STATE))
        done = blend_forward(tile, alive, lists, state, kept, keeps)
        compare_tile(tile, grid, state, comparison, edge)
        blend_backward(tile, done, lists, state, kept, keeps, slots)
        take_ticket(tickets, TILES_DONE)
    step_parameters(tickets, lists, step, comparison.terms, scratch[own : own + SCRATCH])


@kernel
def compare(tickets, strip_columns, grid, pictures, comparison, scratch, by_pictures):
    """Compute losses and gradient images: colour in strips of ``strip_columns`` vectors, then depth in pieces.

    The width of the strips does not change the results.
    """
    own = LANES * take_ticket(tickets, THREAD_TICKET) * (SCRATCH // LANES)
    state, columns = scratch[own : own + SCRATCH], (3 * grid[WIDTH] + LANES - 1) // LANES
    image, target, terms, by_color = pictures.color, comparison.color, comparison.terms, by_pictures.color
    # Floats of the means and backs of a group.
    means, backs = 4 * GROUP_FLOATS * (strip_columns + 2), 3 * GROUP_FLOATS * strip_columns
    at_backs = 3 * means
    at_maps = at_backs + 3 * backs
    at_lines = at_maps + 3 * GROUP_FLOATS * (strip_columns + 2)
    at_blurred = at_lines + 2 * LANES * (strip_columns + 4)
    groups = (grid[HEIGHT] + GROUP_ROWS - 1) // GROUP_ROWS
    while True:
        first = strip_columns * take_ticket(tickets, 3)
        if first >= columns:
            break
        last = min(first + strip_columns, columns)
        strip = Strip(first, last, at_lines, at_blurred, at_maps)
        clear(state, 2 * means, 3 * means)  # rows above the image
        clear(state, at_backs + 2 * backs, at_blurred)  # the same, and columns next to the image
        clear(terms, TERMS * first, TERMS * last)
        for step in range(groups + 2):
            # Group g is stored at position (g + 3) % 3.
            newest, middle, oldest = step % 3, (step + 2) % 3, (step + 1) % 3
            if step <= groups:
                means_of_group(GROUP_ROWS * step, strip, grid, image, target, state, means * newest)
            if step > groups:
                clear(state, at_backs + backs * middle, at_backs + backs * (middle + 1))
            elif step >= 1:
                of_means = Around(means * oldest, means * middle, means * newest)
                maps_of_group(GROUP_ROWS * (step - 1), strip, grid, state, of_means, at_backs + backs * middle, terms)
            if step >= 2:
                of_backs = Around(at_backs + backs * newest, at_backs + backs * oldest, at_backs + backs * middle)
                gradient_of_group(GROUP_ROWS * (step - 2), strip, grid, image, comparison, state, of_backs, by_color)
    pixels = grid[HEIGHT] * grid[WIDTH]
    while True:
        piece = take_ticket(tickets, 4)
        if PIECE * piece >= pixels:
            return
        end = min(PIECE * (piece + 1), pixels)
        error = compare_depth(PIECE * piece, end, pictures, comparison, by_pictures)
        store(terms, TERMS * columns + LANES * piece, error)


@kernel
def unblend(tickets, lists, scratch, kept, pictures, by_pictures, by_layout, step):
    """Run the backward pass after `blend` from the gradients ``by_pictures`` of its images; then take a step.

    ``by_layout [2]`` is the number of floats per row of ``by_pictures.color``, and before the first pixel of a row.
    """
    own = LANES * take_ticket(tickets, THREAD_TICKET) * (SCRATCH // LANES)
    state, spare = scratch[own : own + 64 * COLORED_STATE], scratch[own + 64 * COLORED_STATE : own + SCRATCH]
    grid, tile_order, (alphas, places), slots = lists.grid, lists.tile_order, kept, step.slots
    while True:
        ticket = take_ticket(tickets, 5)
        if ticket >= grid[TILES_X] * grid[TILES_Y]:
            break
        tile = tile_order[ticket]
        read_tile(tile, grid, state, pictures, by_pictures, by_layout)
        place, done = places[2 * tile], places[2 * tile + 1]
        keeps, keep = 0, spare
        if place >= 0:
            keeps, keep = LANES, alphas[place:]
        blend_backward(tile, done, lists, state, keep, keeps, slots)
        take_ticket(tickets, TILES_DONE)
    step_parameters(tickets, lists, step, scratch[:0], scratch[own : own + SCRATCH])


@kernel
def multiply_add(tickets, rounds, pieces, values):
    """Run seven independent chains of multiply-add instructions: the peak rate of the processor, for the benchmark.

    More chains would not fit into the 16 registers of AVX2, two of which hold 16 floats. ``pieces`` pieces of work have
    ``rounds`` rounds each. ``values`` holds the operand, and then the results.
    """
    x = load(values, 0)
    while True:
        piece = take_ticket(tickets, 0)
        if piece >= pieces:
            return
        a, b, c, d, e, f, g = x, x + x, x * x, x - x, x + F(1.0), x + F(2.0), x + F(3.0)
        for _ in range(rounds):
            a, b, c, d, e = fma(a, x, x), fma(b, x, x), fma(c, x, x), fma(d, x, x), fma(e, x, x)
            f, g = fma(f, x, x), fma(g, x, x)
        store(values, LANES * (1 + piece), a + b + c + d + e + f + g)
