"""Define the result of ray casting; importing this module does not load numba."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Hits(NamedTuple):
    """Hold the first intersection of each ray."""

    distance: np.ndarray  # [N] float32, in units of the direction's length; inf for a miss
    face: np.ndarray  # [N] int32, -1 for a miss
    u: np.ndarray  # [N] float32 barycentric: hit = (1 - u - v) A + u B + v C
    v: np.ndarray  # [N] float32
