"""Define named tuples of the arrays that the rasteriser's kernels share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Lists(NamedTuple):
    """Hold the projected map of one camera: records of the Gaussians, and the entries of every tile."""

    # [VIEW_SIZE] float32: `layout.POSE ...` (numba would parse an attribute named ``view`` as a cast)
    camera: np.ndarray
    grid: np.ndarray  # [GRID_SIZE] int64, sizes: `layout.COUNT ...`
    records: np.ndarray  # [chunks * CHUNK * RECORD] float32: `layout.U ...`
    taken: np.ndarray  # [n] int64, ascending: the chunks that may be visible; the others are skipped
    visible: np.ndarray  # [chunks * CHUNK / 16] int32, one bit per Gaussian; valid for the chunks taken
    tile_start: np.ndarray  # [tiles + 1] int64, first entry of each tile
    tile_order: np.ndarray  # [tiles + PLACES] int64, the tiles in processing order, and workspace for sorting them
    entries: np.ndarray  # [ENTRY_ROWS, room] uint64: `layout.KEY ...`


class Found(NamedTuple):
    """Hold the Gaussians that one of many cameras may see."""

    shapes: np.ndarray  # [N * RECORD] float32, of the whole map: `projection.shape_of`
    places: np.ndarray  # [N + LANES] int32, ascending indices of those found, then undefined


class Kept(NamedTuple):
    """Hold alphas and stops that blending stores for the backward pass."""

    alphas: np.ndarray  # [room] float32, 16 per entry and block; empty without a backward pass
    # [2 * tiles] int64: start of each tile's alphas (-1: not stored), and the first entry not blended
    places: np.ndarray


class Pictures(NamedTuple):
    """Hold colour, accumulated depth and alpha of one camera, or a loss's derivatives by them."""

    color: np.ndarray  # [H * STRIDE] float32 with margins; derivatives have their own layout
    depth: np.ndarray  # [H * W] float32
    alpha: np.ndarray  # [H * W] float32


class Comparison(NamedTuple):
    """Hold target images and weights of a loss, and its partial sums."""

    color: np.ndarray  # [H * W * 3] float32, measured
    depth: np.ndarray  # [H * W] float32 metres, measured; 0 = no return
    factors: np.ndarray  # [FACTORS] float32: `tile_losses.OF_COLOR ...`
    terms: np.ndarray  # float32 out, partial sums: `tile_losses.TILE_TERMS`, `image_losses.TERMS`


class Step(NamedTuple):
    """Hold arrays of the second part of a backward kernel; ``rates[MODE]`` selects which are changed."""

    parameters: np.ndarray  # [14, capacity] float32
    first_moment: np.ndarray  # [14, capacity] float32
    second_moment: np.ndarray  # [14, capacity] float32
    rates: np.ndarray  # [RATES] float32: 14 learning rates, then `layout.BETA1 ...`
    slots: np.ndarray  # [entries * 16] float32, the sums of every entry: `layout.V_ ...`
    gradient: np.ndarray  # [14, capacity] float32
    pose_parts: np.ndarray  # [n * 16] float32, of the chunks taken
    results: np.ndarray  # [RESULTS] float64 out: `stepping.OF_POSE`
