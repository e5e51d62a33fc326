"""Compute intervals by the stratified percentile bootstrap: the runs of each scene are drawn with replacement."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from activestructure_gym.evaluation.statistics.aggregates import Statistic, mean

LEVEL = 0.95  # confidence level of intervals
REPEATS = 5000  # resamples; with another seed, an end of the interval moves by about 1 % of the interval's width


@dataclass(frozen=True)
class Estimate:
    """Hold a statistic of all runs, and its bootstrap interval."""

    value: float
    low: float | None  # lower end of the interval; None if a scene has a single run
    high: float | None  # upper end of the interval; None if a scene has a single run
    runs: int  # number of runs, over all scenes

    @property
    def has_interval(self) -> bool:
        """Return whether there is an interval, which needs at least two runs of every scene."""
        return self.low is not None and self.high is not None

    def excludes(self, value: float = 0.0) -> bool:
        """Return whether the interval excludes ``value``; False if there is no interval."""
        return self.low is not None and self.high is not None and (self.low > value or self.high < value)


def estimate(
    strata: Sequence[np.ndarray],
    statistic: Statistic = mean,
    *,
    level: float = LEVEL,
    repeats: int = REPEATS,
    seed: int = 0,
) -> Estimate:
    """Return a statistic of all runs with its interval, by the stratified percentile bootstrap.

    Equal ``strata`` give equal intervals. The draws depend only on the numbers of runs and on ``seed``, so different
    metrics of the same runs are resampled in the same way. With n runs per scene, the intervals are too narrow by a
    factor of about sqrt((n - 1) / n).

    Parameters
    ----------
    strata
        One array [n] per scene, with the values of its n runs, n at least 1.
    statistic
        Aggregate of all runs: `mean`, `median` or `interquartile_mean`.
    level
        Confidence level of the interval: the share of the resampled statistics inside it.
    repeats
        Number of resamples.
    seed
        Seed of the resampling.

    Returns
    -------
    Estimate
        The statistic and its interval. There is no interval if a scene has a single run.

    Raises
    ------
    ValueError
        There is no scene, or a scene has no runs.

    Examples
    --------
    >>> found = estimate([np.array([1.0, 2.0, 3.0]), np.array([5.0, 6.0, 7.0])])
    >>> found.value, found.runs, found.low < 4.0 < found.high
    (4.0, 6, True)
    """
    values, sizes = pooled(strata)
    point = float(statistic(values, sizes))
    if min(sizes) < 2:
        return Estimate(point, None, None, len(values))
    resampled = statistic(values[stratified_draws(sizes, repeats, seed)], sizes)
    low, high = interval(resampled, level)
    return Estimate(point, float(low), float(high), len(values))


def interval(resampled: np.ndarray, level: float = LEVEL) -> np.ndarray:  # [..., R] -> [2, ...]
    """Return the ends of the central interval that holds the share ``level`` of R resampled statistics."""
    return np.percentile(resampled, [50 * (1 - level), 50 * (1 + level)], axis=-1)


def pooled(strata: Sequence[np.ndarray]) -> tuple[np.ndarray, tuple[int, ...]]:
    """Concatenate the values of all scenes to one array [N], and return it with the number of runs of each scene.

    Raise `ValueError` if there is no scene or a scene has no runs.
    """
    sizes = tuple(len(values) for values in strata)
    if not sizes or min(sizes) < 1:
        raise ValueError(f"every scene needs at least one run, got {list(sizes)} runs")
    return np.concatenate([np.asarray(values, np.float64) for values in strata]), sizes


@functools.lru_cache(maxsize=64)
def stratified_draws(sizes: tuple[int, ...], repeats: int, seed: int) -> np.ndarray:  # [R, N] int64, read-only
    """Return R = ``repeats`` resamples, one per row, as indices into the N pooled values of all scenes.

    ``sizes`` is the number of runs of each scene. The part of a row for a scene with n runs holds n of its runs, drawn
    with replacement.
    """
    rng = np.random.default_rng(seed)
    starts = np.cumsum((0, *sizes[:-1]))
    parts = [start + rng.integers(0, size, (repeats, size)) for start, size in zip(starts, sizes)]
    draws = np.concatenate(parts, axis=1)
    draws.setflags(write=False)
    return draws
