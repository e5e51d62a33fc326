"""Compute further results from the tile lists of a rendering: median depth, and images of more channels.

A pass goes over the lists again for a result that most callers do not need. After `Workspace.render`, sorted lists,
records and images are available; after `Workspace.prepare`, records and unsorted lists. Each pass is a function of the
workspace, with its own kernel or those of `kernels`.
"""

# mypy: ignore-errors
# (the arguments of kernels have numba's types)

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.splatting import blending, layout
from activestructure_gym.splatting.counters import take_ticket
from activestructure_gym.splatting.memory import load, lowest_bit, peek, scratch_of, store
from activestructure_gym.splatting.simd import LANES, bits, fma, lane_x, lane_y, neg, sel, spread
from activestructure_gym.splatting.tile_lists import sort_tile
from activestructure_gym.splatting.workspace import Workspace, aligned_zeros

_TO_GRADIENT = np.zeros(layout.RATES, np.float32)
_TO_GRADIENT[layout.MODE] = layout.TO_GRADIENT
_AT_ONCE = 3  # channels blended at once, in place of red, green and blue


def median_depth(workspace: Workspace) -> np.ndarray:  # [H, W] float32 metres
    """Return the depth at each pixel of the Gaussian at which the transmittance first falls to 0.5 or below.

    It is 0 if there is none.
    """
    gaussian = median_gaussian(workspace)
    record = workspace.records.reshape(-1, layout.RECORD)[np.maximum(gaussian, 0)]  # [H, W, 16]
    rows, columns = np.indices(gaussian.shape, np.float32) + np.float32(0.5)
    dx, dy = columns - record[..., layout.U], rows - record[..., layout.V]
    t, s = record[..., layout.L00] * dx + record[..., layout.L01] * dy, record[..., layout.L11] * dy
    depth = record[..., layout.DEPTH] + record[..., layout.SLOPE_T] * t + record[..., layout.SLOPE_S] * s
    return np.where(gaussian >= 0, np.maximum(depth, layout.NEAR_PLANE), np.float32(0.0))


def median_gaussian(workspace: Workspace, *, blended: bool = True) -> np.ndarray:  # [H, W] int64
    """Return the column of the Gaussian at which each pixel's transmittance first falls to 0.5 or below.

    -1 if there is none. With ``blended=False``, only `Workspace.prepare` has run, and the lists are sorted here. After
    blending they must not be sorted again, since `Workspace.backward` would fail.
    """
    camera = workspace.camera
    picture = np.empty((camera.height, camera.width), np.float32)  # exact for column numbers up to 16 million
    workspace.tickets[:] = 0
    workspace._run(_median, workspace.lists, not blended, picture.reshape(-1))
    return picture.astype(np.int64)


@kernel
def _median(tickets, lists, sorts, picture):
    view, grid, records, entries = lists.camera, lists.grid, lists.records, lists.entries
    tile_start, tile_order = lists.tile_start, lists.tile_order
    width = 2 * LANES  # floats of state per block: transmittance, column of the Gaussian that was found
    state, digits = scratch_of(64 * width), np.empty(layout.DIGITS, np.int64)
    half, nobody = np.float32(0.5), spread(np.float32(-1.0))
    room, tiles_x = entries.shape[1], grid[layout.TILES_X]
    while True:
        ticket = take_ticket(tickets, 0)
        if ticket >= tiles_x * grid[layout.TILES_Y]:
            return
        tile = tile_order[ticket]
        x, y = layout.TILE * (tile % tiles_x), layout.TILE * (tile // tiles_x)
        if sorts:
            sort_tile(tile, lists, digits)
        alive = blending.open_tile(tile, grid, state, width)
        for block in range(64):
            store(state, width * block + LANES, nobody)
        for entry in range(tile_start[tile], tile_start[tile + 1]):
            if alive == 0:
                break
            reach = np.int64(peek(entries, layout.SORTED_REACH * room + entry)) & alive
            if reach == 0:
                continue
            column_of = np.int64(peek(entries, layout.SORTED_SPLAT * room + entry) & np.uint64(0xFFFFFFFF))
            base = layout.RECORD * column_of
            dx = lane_x() - (peek(records, base + layout.U) - np.float32(x))
            dy = lane_y() - (peek(records, base + layout.V) - np.float32(y))
            along = fma(dx, peek(records, base + layout.L00), dy * peek(records, base + layout.L01))
            across = dy * peek(records, base + layout.L11)
            while reach != 0:
                block = lowest_bit(reach)
                reach &= reach - 1
                at = width * block
                opaque = blending.alpha_of(records, base, block, along, across, view)
                before = load(state, at)
                after = fma(neg(opaque), before, before)
                goes_on = after > peek(view, layout.MIN_LEFT)  # otherwise this Gaussian is not blended into the pixel
                crosses = goes_on & (after <= half)
                found = sel(crosses, spread(np.float32(column_of)), load(state, at + LANES))
                store(state, at + LANES, found)
                searching = goes_on & (after > half)
                store(state, at, sel(searching, after, blending.stopped(before)))
                if bits(searching) == 0:
                    alive &= ~(1 << block)
        for block in range(64):
            left, top = x + 4 * (block & 7), y + 4 * (block >> 3)
            for row in range(min(4, grid[layout.HEIGHT] - top)):
                for column in range(min(4, grid[layout.WIDTH] - left)):
                    value = state[width * block + LANES + 4 * row + column]
                    picture[(top + row) * grid[layout.WIDTH] + left + column] = value


def blend_channels(
    workspace: Workspace,
    channels: np.ndarray,  # [N, D] float32
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return an image ``[H, W, D]`` of any values per Gaussian, blended like colours, and data for `unblend_channels`.

    Three channels at a time replace the colours in the records, and the lists are blended again.
    """
    picture = np.empty((workspace.camera.height, workspace.camera.width, channels.shape[1]), np.float32)
    kept, colors, own = [], _colors(workspace, len(channels)), workspace.color
    before = colors.copy()
    for first in range(0, channels.shape[1], _AT_ONCE):
        share = channels[:, first : first + _AT_ONCE]
        _paint(colors, share)
        workspace.color = aligned_zeros(workspace.camera.height * int(workspace.grid[layout.STRIDE]))
        workspace.blend()
        picture[..., first : first + _AT_ONCE] = workspace.pixels_of(workspace.color)[..., : share.shape[1]]
        kept.append(workspace.color)
    colors[:], workspace.color = before, own
    return picture, kept


def unblend_channels(
    workspace: Workspace,
    channels: np.ndarray,  # [N, D] float32
    kept: list[np.ndarray],  # from `blend_channels`
    by_picture: np.ndarray,  # [H, W, D] float32 gradient by the image
    gradient: np.ndarray,  # [14, capacity] float32: the result is added to rows 0 to 10 (geometry)
    by_channels: np.ndarray,  # [N, D] float32: the result is added
) -> np.ndarray:  # [3, 4] gradient by camera_from_world
    """Compute the gradient of `blend_channels`.

    It is linear in the gradient image, so groups of three channels add up.
    """
    height, width = by_picture.shape[:2]
    count, own = len(channels), workspace.color
    colors, nothing = _colors(workspace, count), np.zeros((height, width), np.float32)
    before, by_pose = colors.copy(), np.zeros((3, 4), np.float32)
    part, of_group = np.zeros_like(gradient), np.zeros((height, width, _AT_ONCE), np.float32)
    for number, image in enumerate(kept):
        first = number * _AT_ONCE
        share = channels[:, first : first + _AT_ONCE]
        _paint(colors, share)
        workspace.color = image
        of_group[..., share.shape[1] :] = 0.0
        of_group[..., : share.shape[1]] = by_picture[..., first : first + _AT_ONCE]
        workspace.set_gradient_images(of_group, nothing, nothing)
        by_pose += workspace.backward(_TO_GRADIENT, part, part, part)
        gradient[: layout.ROWS - 3] += part[: layout.ROWS - 3]
        by_channels[:, first : first + _AT_ONCE] += part[layout.ROWS - 3 : layout.ROWS - 3 + share.shape[1], :count].T
    colors[:], workspace.color = before, own
    return by_pose


def _colors(workspace: Workspace, count: int) -> np.ndarray:  # [N, 3], a view
    """Return a view of the colours in the records of ``count`` Gaussians."""
    assert (layout.GREEN, layout.BLUE) == (layout.RED + 1, layout.RED + 2)
    return workspace.records[: count * layout.RECORD].reshape(count, layout.RECORD)[:, layout.RED : layout.RED + 3]


def _paint(colors: np.ndarray, share: np.ndarray) -> None:
    colors[:, : share.shape[1]] = share
    colors[:, share.shape[1] :] = 0.0
