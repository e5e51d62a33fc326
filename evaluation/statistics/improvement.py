"""Probability of improvement: that a run of one policy is better than a run of another."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from activestructure_gym.evaluation.statistics.resampling import LEVEL, REPEATS, Estimate, interval


def win_share(ours: np.ndarray, theirs: np.ndarray, tie: float = 0.0) -> np.ndarray:  # [n], [m] -> [n, m]
    """1 where ours is larger, 1/2 where both are equal; the mean is Mann and Whitney's U / (n m).

    What differs by no more than ``tie`` is equal.
    """
    difference = np.asarray(ours, np.float64)[:, None] - np.asarray(theirs, np.float64)[None, :]
    return 0.5 * (1.0 + np.where(np.abs(difference) > tie, np.sign(difference), 0.0))


def probability_of_improvement(
    ours: Sequence[np.ndarray],  # one [n] per scene; larger is better
    theirs: Sequence[np.ndarray],  # one [m] per scene, the same scenes
    *,
    tie: float = 0.0,  # runs that differ by no more than this are equal
    level: float = LEVEL,
    repeats: int = REPEATS,
    seed: int = 0,
) -> Estimate:
    """P(X > Y) + P(X = Y) / 2 for runs X of ours and Y of theirs on the same scene, averaged over the scenes.

    rliable's ``probability_of_improvement``; for the interval the runs of both are drawn again, independently, within
    every scene.

    Parameters
    ----------
    ours, theirs
        One array of runs per scene, the same scenes; larger is better.
    tie
        Runs that differ by no more than this are equal.
    level
        Share of the resampled statistics inside the interval.
    repeats
        Resamples.
    seed
        Of the draws.

    Returns
    -------
    Estimate
        In 0..1, with its interval.

    Raises
    ------
    ValueError
        The scenes do not match.

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
    """Of every sample of n runs drawn again the share that each of them has in it."""
    rng = np.random.default_rng(seed)
    drawn = tuple(rng.multinomial(size, np.full(size, 1.0 / size), repeats) / size for size in sizes)
    for weights in drawn:
        weights.setflags(write=False)
    return drawn
