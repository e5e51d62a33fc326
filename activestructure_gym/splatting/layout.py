"""Define the layout of the rasteriser's arrays, the sizes of its work units, and the constants of the model."""

from __future__ import annotations

import numpy as np

from activestructure_gym.splatting.simd import F

CHUNK = 1024  # Gaussians per unit of work
TILE = 32  # pixels per side of a tile
RECORD = 16  # floats of a Gaussian's record, 64 bytes
ROWS = 14  # rows of the parameter array
DIGITS = 2048  # size of the table of digits in the depth sort
# Floats of workspace per thread: blocks of a tile and 24,500 alphas of 16 pixels, within a second-level cache.
SCRATCH = 400_000
# rates: a learning rate per parameter row, then these. MODE selects the result of the backward pass. ISOTROPIC (0 or 1)
# makes the three log-scales of a Gaussian one parameter: each gets the sum of their gradients.
BETA1, BETA2, EPSILON, MODE, ISOTROPIC, RATES = range(14, 20)
POSE_ONLY, TO_GRADIENT, TO_ADAM = -1.0, 0.0, 1.0  # values of MODE
PLACES = 258  # integers after the tiles in ``tile_order``, workspace for sorting the tiles

NEAR_PLANE = F(0.01)  # metres
# px^2; gsplat uses 0.3, at which disks of the size of a pixel blur the image (docs/notebook/map.md).
BLUR_VARIANCE = F(0.02)
# px^2, added to the covariance in the image for depth slopes only. It keeps the slope of a disk seen edge-on finite.
SLANT_VARIANCE = F(0.03)
MIN_TRANSMITTANCE = F(1e-4)  # a pixel stops before its transmittance falls to this
# Fraction of half the image: the projection's Jacobian follows the mean up to this margin outside the image.
CLAMP_MARGIN = 0.3
LOG2_E = F(1.4426950408889634)
LOG2_255 = F(7.994353436858858)
ROOT = F(0.8493218002880191)  # sqrt(log2(e) / 2): alpha = 2^(lo - t^2 - s^2)
LN_4 = F(1.3862943611198906)  # 1 / ROOT^2
SLACK = F(0.01)  # px added around every ellipse, far above rounding errors of its border

# view: floats that describe a camera
POSE, FX, FY, CX, CY, LOW_X, HIGH_X, LOW_Y, HIGH_Y, MAX_ALPHA, SLANT, BLUR, CONSTANTS, VIEW_SIZE = 0, *range(12, 24), 48
# grid: integers that describe a rendering
COUNT, CAPACITY, WIDTH, HEIGHT, TILES_X, TILES_Y, CHUNKS, BLOCKS_X, BLOCKS_Y, STRIDE, MARGIN = range(11)
TILE_BLOCKS, GRID_SIZE = 11, 12  # TILE_BLOCKS is 64; a constant would make the compiler unroll the loops
# record: floats of a Gaussian. t = L00 dx + L01 dy and s = L11 dy at pixel offset (dx, dy); the depth at a pixel is
# DEPTH + SLOPE_T t + SLOPE_S s. BOX_X and BOX_Y hold first + last << 16 in blocks, until SLOT and SLOTS replace them.
U, V, L00, L01, L11, LOG_OPACITY, RED, GREEN, BLUE, DEPTH, SLOPE_T, SLOPE_S, BITMAP, BOX_X, BOX_Y = (*range(13), 14, 15)
SLOT, SLOTS = BOX_X, BOX_Y
# Rows of the array of entries.
KEY, KEY_2, SPLAT_KEY, REACH, SORTED_REACH, SORTED_SPLAT, ENTRY_ROWS = range(7)
# slot: sums of an entry over its pixels
V_, VT, VS, VTT, VTS, VSS, W_RED, W_GREEN, W_BLUE, W_DEPTH, W_ALL, W_DEPTH_T, W_DEPTH_S = range(13)

# Constants of the innermost loops, stored in memory after every view. LLVM would move literals out of the loop and
# store them on a stack that is not aligned to 64 bytes, where every load takes two cache lines.
MAGIC, EXP_5, EXP_4, EXP_3, EXP_2, EXP_1, ONE, MIN_POWER, MIN_LEFT, MIN_DEPTH = range(CONSTANTS, CONSTANTS + 10)
CONSTANT_VALUES = np.array(
    [
        12582912.0, 1.3264725e-3, 9.6715127e-3, 5.5507337e-2, 0.24022242, 0.69314698, 1.0, -LOG2_255, MIN_TRANSMITTANCE,
        NEAR_PLANE,
    ], np.float32,
)  # fmt: skip
