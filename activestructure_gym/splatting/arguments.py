"""Named tuples of arrays that the rasteriser's kernels take together."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Lists(NamedTuple):
    """The projected map of one camera: records of the Gaussians, and the entries of every tile."""

    camera: np.ndarray  # [VIEW_SIZE] float32: `layout.POSE ...` (numba takes an attribute ``view`` for a cast)
    grid: np.ndarray  # [GRID_SIZE] int64, sizes: `layout.COUNT ...`
    records: np.ndarray  # [chunks * CHUNK * RECORD] float32: `layout.U ...`
    taken: np.ndarray  # [n] int64, the chunks that may be in view, rising; the others are never looked at
    visible: np.ndarray  # [chunks * CHUNK / 16] int32, a bit per Gaussian; only of the chunks taken
    tile_start: np.ndarray  # [tiles + 1] int64, first entry of each tile
    tile_order: np.ndarray  # [tiles + PLACES] int64, the tiles as they are taken, and room for ordering them
    entries: np.ndarray  # [ENTRY_ROWS, room] uint64: `layout.KEY ...`


class Found(NamedTuple):
    """The Gaussians that one of many cameras may see."""

    shapes: np.ndarray  # [N * RECORD] float32, of the whole map: `projection.shape_of`
    places: np.ndarray  # [N + LANES] int32, rising numbers of those found, then any


class Kept(NamedTuple):
    """Alphas and stops that blending stores for the backward pass."""

    alphas: np.ndarray  # [room] float32, 16 per entry and block; none where nothing goes back
    places: np.ndarray  # [2 * tiles] int64: where those of a tile start (-1: not kept), and the first entry not blended


class Pictures(NamedTuple):
    """Colour, accumulated depth and alpha of one camera, or the derivatives of a loss by them."""

    color: np.ndarray  # [H * STRIDE] float32 with margins; derivatives come with a layout of their own
    depth: np.ndarray  # [H * W] float32
    alpha: np.ndarray  # [H * W] float32


class Comparison(NamedTuple):
    """Target images and weights of a loss, and the parts of its sums."""

    color: np.ndarray  # [H * W * 3] float32, measured
    depth: np.ndarray  # [H * W] float32 metres, measured; 0 = no return
    factors: np.ndarray  # [FACTORS] float32: `tile_losses.OF_COLOR ...`
    terms: np.ndarray  # float32 out, the parts of the sums: `tile_losses.TILE_TERMS`, `image_losses.TERMS`


class Step(NamedTuple):
    """Arrays of the second part of a backward kernel; ``rates[MODE]`` says which of them it changes."""

    parameters: np.ndarray  # [14, capacity] float32
    first_moment: np.ndarray  # [14, capacity] float32
    second_moment: np.ndarray  # [14, capacity] float32
    rates: np.ndarray  # [RATES] float32: 14 learning rates, then `layout.BETA1 ...`
    slots: np.ndarray  # [entries * 16] float32, the sums of every entry: `layout.V_ ...`
    gradient: np.ndarray  # [14, capacity] float32
    pose_parts: np.ndarray  # [n * 16] float32, of the chunks taken
    results: np.ndarray  # [RESULTS] float64 out: `stepping.OF_POSE`
