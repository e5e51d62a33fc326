"""Aggregate the values of all runs to one number: mean, median or interquartile mean.

The functions work along the last axis, so every row of an array can be one resample. ``values`` [..., N] has one value
per run, scene after scene; ``sizes`` has the number of runs of each of the S scenes, with sum N.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

# An aggregate: maps ``values`` [..., N] and ``sizes`` [S], as defined above, to one number per row [...].
Statistic = Callable[[np.ndarray, Sequence[int]], np.ndarray]


def scene_means(values: np.ndarray, sizes: Sequence[int]) -> np.ndarray:  # [..., N] -> [..., S]
    """Return the mean of each scene's runs."""
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
    return np.add.reduceat(values, starts, axis=-1) / np.asarray(sizes, np.float64)


def mean(values: np.ndarray, sizes: Sequence[int]) -> np.ndarray:
    """Return the mean of the scene means [...]; every scene has the same weight."""
    return scene_means(values, sizes).mean(axis=-1)


def median(values: np.ndarray, sizes: Sequence[int]) -> np.ndarray:
    """Return the median of the scene means [...]; with a single scene, the median of its runs.

    The median of the scene means is rliable's ``aggregate_median``.
    """
    return np.median(values if len(sizes) == 1 else scene_means(values, sizes), axis=-1)


def interquartile_mean(values: np.ndarray, sizes: Sequence[int]) -> np.ndarray:
    """Return the mean of the middle half of all runs [...].

    The runs of all scenes are sorted together, and the floor(N / 4) lowest and highest are left out.
    """
    count = values.shape[-1]
    cut = count // 4
    return np.sort(values, axis=-1)[..., cut : count - cut].mean(axis=-1)


STATISTICS: dict[str, Statistic] = {"mean": mean, "median": median, "IQM": interquartile_mean}
