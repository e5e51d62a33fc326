"""Compute the probability of improvement: that a run of one policy is better than a run of another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def win_share(ours: np.ndarray, theirs: np.ndarray, tie: float = 0.0) -> np.ndarray:  # [n], [m] -> [n, m]
    """Compare each of n values with each of m values: 1 where the value in ``ours`` is larger, 1/2 where equal, else 0.

    Two values are equal if they differ by at most ``tie``. The mean of the result is the U of Mann and Whitney divided
    by n m.
    """
    difference = np.asarray(ours, np.float64)[:, None] - np.asarray(theirs, np.float64)[None, :]
    return 0.5 * (1.0 + np.where(np.abs(difference) > tie, np.sign(difference), 0.0))


def probability_of_improvement(ours: Sequence[np.ndarray], theirs: Sequence[np.ndarray], *, tie: float = 0.0) -> float:
    """Return P(X > Y) + P(X = Y) / 2 for a run X of ``ours`` and a run Y of ``theirs``, averaged over the scenes.

    This is rliable's ``probability_of_improvement``. It has no interval: that of a bootstrap is empty if all runs of
    one policy are better, however few they are.

    Parameters
    ----------
    ours, theirs
        Values of the runs of two policies: one array per scene, in the same order of scenes. Larger is better.
    tie
        Runs that differ by no more than this are equal.

    Returns
    -------
    float
        The probability in 0..1.

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
    >>> probability_of_improvement([np.array([1.0, 2.0])], [np.array([0.0, 1.0])])
    0.875
    """
    if len(ours) != len(theirs) or not ours or min(map(len, (*ours, *theirs))) < 1:
        raise ValueError(f"both need runs on the same scenes, got {[*map(len, ours)]} and {[*map(len, theirs)]} runs")
    return float(np.mean([win_share(x, y, tie).mean() for x, y in zip(ours, theirs)]))
