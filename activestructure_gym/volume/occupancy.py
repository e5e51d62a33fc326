"""Compute the probability that a voxel is occupied from the evidence that the volume keeps.

The prior is 1/2, so the odds of occupied against free are 1 without evidence. Hits count as in [octomap]. The odds of
other voxels follow a measurement in a room and an apartment (60 frames, presets fast and default). A surface was in 3
to 9 % of the voxels whose centre a ray had crossed. It was in less than 0.1 % of those that a view had tested as a
whole.
"""

from __future__ import annotations

import numpy as np

HIT_ODDS = 0.7 / 0.3  # odds of a voxel in which a depth return ended in one image
MOST_ODDS = 0.97 / 0.03  # limit of the odds of a voxel with many hits
CROSSED_ODDS = 0.05 / 0.95  # odds of a voxel whose centre a ray crossed, or that a ray without a return crossed
TESTED_ODDS = 0.01 / 0.99  # odds of a voxel that a view tested as a whole, times its miss chance (own choice)


def occupancy(
    solidity: np.ndarray,  # [X, Y, Z] int16 hit counter; above 0 in occupied voxels
    miss_chance: np.ndarray,  # [X, Y, Z] float32 probability that all views missed a thin structure in the voxel
    crossed: np.ndarray,  # [X, Y, Z] bool: a ray crossed the voxel's centre, or a ray without a return the voxel
    hit_gain: int,  # increase of the hit counter by one hit
) -> np.ndarray:  # [X, Y, Z] float32 in 0..1
    """Return the occupancy odds / (1 + odds) of each voxel; exactly 0.5 without evidence.

    - A voxel with hits has the odds (0.7 / 0.3)^(solidity / hit_gain), at most 0.97 / 0.03. Views that prove it free
      lower the counter.
    - A voxel that a view tested as a whole has the odds m 0.01 / 0.99 with the miss chance m < 1. It is 0 in voxels
      that are certainly free.
    - Another voxel whose centre a ray crossed, or that a ray without a return crossed, has the odds 0.05 / 0.95.
    """
    odds = np.where(crossed, np.float32(CROSSED_ODDS), np.float32(1.0))
    odds = np.where(miss_chance < 1.0, miss_chance * np.float32(TESTED_ODDS), odds)
    hit = solidity > 0
    odds[hit] = np.minimum(HIT_ODDS ** (solidity[hit] / hit_gain), MOST_ODDS)
    return odds / (1.0 + odds)
