"""Distribute unit directions evenly over the sphere."""

from __future__ import annotations

import numpy as np


def fibonacci_directions(count: int) -> np.ndarray:  # [count, 3] unit
    """Return near-uniform unit directions on the sphere: the Fibonacci lattice (paper, Sec. 3.4).

    Direction i of K = ``count`` has z = 1 - (2i + 1) / K and azimuth 2 pi i / golden ratio, as in ActiveGAMER's code.
    """
    if count < 1:
        raise ValueError(f"count must be at least 1, got {count}")
    index = np.arange(count)
    z = 1.0 - (2.0 * index + 1.0) / count
    azimuth = 2.0 * np.pi * index / ((1.0 + np.sqrt(5.0)) / 2.0)
    radius = np.sqrt(1.0 - z**2)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)
