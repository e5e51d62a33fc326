"""Layout of the rasteriser's arrays, sizes of its units, and the constants of the model (gsplat's)."""

from __future__ import annotations

import numpy as np

from activestructure_gym.splatting.simd import F

CHUNK = 1024  # Gaussians per unit of work
TILE = 32  # pixels
RECORD = 16  # floats per Gaussian, 64 bytes
ROWS = 14  # of the parameter array
DIGITS = 2048  # of the depth sort
SCRATCH = 400_000  # floats per thread: the blocks of a tile and 24,500 alphas of 16 pixels, well within a second cache
# rates: a learning rate per row, then these. MODE says what the backward pass is for; ISOTROPIC (0 or 1) ties the three
# log-scales of a Gaussian together: each gets the derivative by all of them.
BETA1, BETA2, EPSILON, MODE, ISOTROPIC, RATES = range(14, 20)
POSE_ONLY, TO_GRADIENT, TO_ADAM = -1.0, 0.0, 1.0
PLACES = 258  # integers behind the tiles in ``tile_order``: room for ordering them

NEAR_PLANE = F(0.01)
BLUR_VARIANCE = F(0.02)  # px^2; gsplat's own is 0.3, at which disks of a pixel blur the picture (docs/notebook/map.md)
SLANT_VARIANCE = F(0.03)  # px^2, where depth is concerned: a disk seen from its edge has no slope that could be drawn
MIN_TRANSMITTANCE = F(1e-4)
CLAMP_MARGIN = 0.3  # of half the image
LOG2_E = F(1.4426950408889634)
LOG2_255 = F(7.994353436858858)
ROOT = F(0.8493218002880191)  # sqrt(log2(e) / 2): alpha = 2^(lo - t^2 - s^2)
LN_4 = F(1.3862943611198906)  # 1 / ROOT^2
SLACK = F(0.01)  # px around every ellipse, far above the rounding of its border

# view: floats of a camera
POSE, FX, FY, CX, CY, LOW_X, HIGH_X, LOW_Y, HIGH_Y, MAX_ALPHA, SLANT, BLUR, CONSTANTS, VIEW_SIZE = 0, *range(12, 24), 48
# grid: integers of a rendering
COUNT, CAPACITY, WIDTH, HEIGHT, TILES_X, TILES_Y, CHUNKS, BLOCKS_X, BLOCKS_Y, STRIDE, MARGIN = range(11)
TILE_BLOCKS, GRID_SIZE = 11, 12  # 64, as a number that the compiler does not know: it would unroll the loops
# record: t = L00 dx + L01 dy, s = L11 dy, depth at a pixel DEPTH + SLOPE_T t + SLOPE_S s; BOX_X and BOX_Y hold first +
# last << 16 in blocks until fill puts SLOT and SLOTS in their place
U, V, L00, L01, L11, LOG_OPACITY, RED, GREEN, BLUE, DEPTH, SLOPE_T, SLOPE_S, BITMAP, BOX_X, BOX_Y = (*range(13), 14, 15)
SLOT, SLOTS = BOX_X, BOX_Y
# rows of the array of entries
KEY, KEY_2, SPLAT_KEY, REACH, SORTED_REACH, SORTED_SPLAT, ENTRY_ROWS = range(7)
# sums of a slot
V_, VT, VS, VTT, VTS, VSS, W_RED, W_GREEN, W_BLUE, W_DEPTH, W_ALL, W_DEPTH_T, W_DEPTH_S = range(13)

# The numbers of the hot loops, as memory operands behind every view: as literals LLVM hoists them out of the loop and
# spills them to a stack that is not aligned to 64 bytes, where every reload takes two cache lines.
MAGIC, EXP_5, EXP_4, EXP_3, EXP_2, EXP_1, ONE, LEAST_POWER, LEAST_LEFT, LEAST_DEPTH = range(CONSTANTS, CONSTANTS + 10)
CONSTANT_VALUES = np.array(
    [
        12582912.0, 1.3264725e-3, 9.6715127e-3, 5.5507337e-2, 0.24022242, 0.69314698, 1.0, -LOG2_255, MIN_TRANSMITTANCE,
        NEAR_PLANE,
    ], np.float32,
)  # fmt: skip
