"""Compute the probability of improvement: that a run of one policy is better than a run of another."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from activestructure_gym.evaluation.statistics.resampling import LEVEL, REPEATS, Estimate, interval


def win_share(ours: np.ndarray, theirs: np.ndarray, tie: float = 0.0) -> np.ndarray:  # [n], [m] -> [n, m]
    """Compare each of n values with each of m values: 1 where the value in ``ours`` is larger, 1/2 where equal, else 0.

    Two values are equal if they differ by at most ``tie``. The mean of the result is the U of Mann and Whitney divided
    by n m.
    """
    difference = np.asarray(ours, np.float64)[:, None] - np.asarray(theirs, np.float64)[None, :]
    return 0.5 * (1.0 + np.where(np.abs(difference) > tie, np.sign(difference), 0.0))


def probability_of_improvement(
    ours: Sequence[np.ndarray],
    theirs: Sequence[np.ndarray],
    *,
    tie: float = 0.0,
    level: float = LEVEL,
    repeats: int = REPEATS,
    seed: int = 0,
) -> Estimate:
    """Return P(X > Y) + P(X = Y) / 2 for a run X of ``ours`` and a run Y of ``theirs``, averaged over the scenes.

    This is rliable's ``probability_of_improvement``. For the interval, the runs of both policies are resampled
    independently within each scene. There is no interval if a scene has a single run of a policy.

    Parameters
    ----------
    ours, theirs
        Values of the runs of two policies: one array per scene, in the same order of scenes. Larger is better.
    tie
        Runs that differ by no more than this are equal.
    level
        Confidence level of the interval: the share of the resampled statistics inside it.
    repeats
        Number of resamples.
    seed
        Seed of the resampling.

    Returns
    -------
    Estimate
        The probability in 0..1, with its interval.

    Raises
    ------
    ValueError
        The numbers of scenes differ, there is no scene, or a scene has no run.

    Notes
    -----
    Source: Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical Precipice", NeurIPS 2021,
    section 4.3.

    Examples
    --------
    >>> probability_of_improvement([np.array([1.0, 2.0])], [np.array([0.0, 1.0])]).value
    0.875
    """
    if len(ours) != len(theirs) or not ours or min(map(len, (*ours, *theirs))) < 1:
        raise ValueError(f"both need runs on the same scenes, got {[*map(len, ours)]} and {[*map(len, theirs)]} runs")
    shares = [win_share(x, y, tie) for x, y in zip(ours, theirs)]
    point = float(np.mean([share.mean() for share in shares]))
    runs = sum(map(len, ours)) + sum(map(len, theirs))
    if min(map(len, (*ours, *theirs))) < 2:
        return Estimate(point, None, None, runs)
    total = np.zeros(repeats)
    sizes = tuple(size for share in shares for size in share.shape)
    drawn = iter(_weights(sizes, repeats, seed))
    for share in shares:
        total += ((next(drawn) @ share) * next(drawn)).sum(axis=1)
    low, high = interval(total / len(shares), level)
    return Estimate(point, float(low), float(high), runs)


@functools.lru_cache(maxsize=64)
def _weights(sizes: tuple[int, ...], repeats: int, seed: int) -> tuple[np.ndarray, ...]:  # [R, n] each, read-only
    """Return the share of each run in each of R = ``repeats`` resamples: one array [R, n] per entry n of ``sizes``."""
    rng = np.random.default_rng(seed)
    drawn = tuple(rng.multinomial(size, np.full(size, 1.0 / size), repeats) / size for size in sizes)
    for weights in drawn:
        weights.setflags(write=False)
    return drawn
