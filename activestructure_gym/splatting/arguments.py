"""Define named tuples of arrays that the kernels of the rasteriser share as arguments."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Lists(NamedTuple):
    """Hold the projected map of one camera: a record per Gaussian, and the sorted list of Gaussians of every tile.

    An entry is a pair of tile and Gaussian. "Chunks taken" are the chunks of 1024 Gaussians that may be visible.
    """

    # [VIEW_SIZE] float32 camera: `layout.POSE ...`. numba would parse an attribute named ``view`` as a cast.
    camera: np.ndarray
    grid: np.ndarray  # [GRID_SIZE] int64 sizes of the rendering: `layout.COUNT ...`
    records: np.ndarray  # [chunks * CHUNK * RECORD] float32 records: `layout.U ...`
    taken: np.ndarray  # [n] int64, increasing: chunks taken
    visible: np.ndarray  # [chunks * CHUNK / 16] int32, one bit per Gaussian; valid for the chunks taken
    tile_start: np.ndarray  # [tiles + 1] int64, first entry of each tile
    tile_order: np.ndarray  # [tiles + PLACES] int64, tiles in processing order, then workspace
    entries: np.ndarray  # [ENTRY_ROWS, room] uint64 entries: `layout.KEY ...`


class Kept(NamedTuple):
    """Hold the alphas that blending stores for the backward pass."""

    alphas: np.ndarray  # [room] float32, 16 per entry and block of pixels; empty without a backward pass
    # [2 * tiles] int64, per tile: start of its alphas (-1: not stored), and the first entry that was not blended.
    places: np.ndarray


class Pictures(NamedTuple):
    """Hold colour, accumulated depth and alpha of one camera, or the derivatives of a loss with respect to them."""

    color: np.ndarray  # [H * STRIDE] float32 with margins; the layout of derivatives is given separately
    depth: np.ndarray  # [H * W] float32
    alpha: np.ndarray  # [H * W] float32


class Comparison(NamedTuple):
    """Hold the target images, weights and partial sums of a loss."""

    color: np.ndarray  # [H * W * 3] float32 measured colours
    depth: np.ndarray  # [H * W] float32 measured depth in metres, 0 = no return
    factors: np.ndarray  # [FACTORS] float32 weights: `tile_losses.OF_COLOR ...`
    terms: np.ndarray  # float32 partial sums, output: `tile_losses.TILE_TERMS`, `image_losses.TERMS`


class Step(NamedTuple):
    """Hold the arrays of the second part of a backward kernel. ``rates[MODE]`` selects which of them are changed."""

    parameters: np.ndarray  # [14, capacity] float32
    first_moment: np.ndarray  # [14, capacity] float32
    second_moment: np.ndarray  # [14, capacity] float32
    rates: np.ndarray  # [RATES] float32: 14 learning rates, then `layout.BETA1 ...`
    slots: np.ndarray  # [entries * 16] float32 sums over the pixels of every entry: `layout.V_ ...`
    gradient: np.ndarray  # [14, capacity] float32
    pose_parts: np.ndarray  # [n * 16] float32 gradient of the pose from each chunk taken
    results: np.ndarray  # [RESULTS] float64 output: `stepping.OF_POSE`
