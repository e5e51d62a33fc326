"""One number for all runs: mean, median, interquartile mean; along the last axis, so that resamples are rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

# From values [..., N], scene after scene, and the scenes' numbers of runs (sum N) to one number per row [...].
Statistic = Callable[[np.ndarray, Sequence[int]], np.ndarray]


def scene_means(values: np.ndarray, sizes: Sequence[int]) -> np.ndarray:  # [..., N] -> [..., S]
    """The mean of every scene's runs."""
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
    return np.add.reduceat(values, starts, axis=-1) / np.asarray(sizes, np.float64)


def mean(values: np.ndarray, sizes: Sequence[int]) -> np.ndarray:
    """The mean over the scenes of the mean over their runs: every scene counts the same."""
    return scene_means(values, sizes).mean(axis=-1)


def median(values: np.ndarray, sizes: Sequence[int]) -> np.ndarray:
    """The median over the scenes of the mean over their runs; with one scene the median over its runs.

    The first is rliable's ``aggregate_median``, which would be the mean where there is one scene only.
    """
    return np.median(values if len(sizes) == 1 else scene_means(values, sizes), axis=-1)


def interquartile_mean(values: np.ndarray, sizes: Sequence[int]) -> np.ndarray:
    """The mean of the middle half of all runs of all scenes: the lowest and highest floor(N / 4) are left out."""
    count = values.shape[-1]
    cut = count // 4
    return np.sort(values, axis=-1)[..., cut : count - cut].mean(axis=-1)


STATISTICS: dict[str, Statistic] = {"mean": mean, "median": median, "IQM": interquartile_mean}
