"""Aggregate all runs to one number: mean, median or interquartile mean.

The functions work along the last axis, so that every row can be one resample.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

# Maps values [..., N], scene after scene, and each scene's number of runs (sum N) to one number per row [...].
Statistic = Callable[[np.ndarray, Sequence[int]], np.ndarray]


def scene_means(values: np.ndarray, sizes: Sequence[int]) -> np.ndarray:  # [..., N] -> [..., S]
    """Return the mean over the runs of each scene."""
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
    return np.add.reduceat(values, starts, axis=-1) / np.asarray(sizes, np.float64)


def mean(values: np.ndarray, sizes: Sequence[int]) -> np.ndarray:
    """Return the mean over scenes of the means over their runs; every scene has the same weight."""
    return scene_means(values, sizes).mean(axis=-1)


def median(values: np.ndarray, sizes: Sequence[int]) -> np.ndarray:
    """Return the median over scenes of the means over their runs; with one scene, the median over its runs.

    The median over scenes is rliable's ``aggregate_median``. With a single scene that would be the mean over its runs.
    """
    return np.median(values if len(sizes) == 1 else scene_means(values, sizes), axis=-1)


def interquartile_mean(values: np.ndarray, sizes: Sequence[int]) -> np.ndarray:
    """Return the mean of the middle half of all runs, without the floor(N / 4) lowest and the floor(N / 4) highest.

    The runs of all scenes are sorted together.
    """
    count = values.shape[-1]
    cut = count // 4
    return np.sort(values, axis=-1)[..., cut : count - cut].mean(axis=-1)


STATISTICS: dict[str, Statistic] = {"mean": mean, "median": median, "IQM": interquartile_mean}
