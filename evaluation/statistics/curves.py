"""Convergence: curves of many runs on one axis, their band, and the area under each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from activestructure_gym.evaluation.statistics.aggregates import Statistic, mean
from activestructure_gym.evaluation.statistics.resampling import LEVEL, interval, pooled, stratified_draws

BAND_REPEATS = 1000  # resamples of a band, which is looked at and not read off


def on_axis(x: np.ndarray, y: np.ndarray, axis: np.ndarray) -> np.ndarray:  # [P], [P], [G] -> [G]
    """The curve through the points, straight between them, at every place of ``axis``.

    Before the first point it has the first value, after the last the last: an episode that has ended keeps its map.
    """
    if len(x) < 1 or np.any(np.diff(x) <= 0):
        raise ValueError("a curve needs at least one point, and costs that rise strictly")
    return np.interp(axis, x, y)


def area_under(x: np.ndarray, y: np.ndarray, budget: float) -> float:
    """The mean height of the curve from 0 to ``budget`` in the units of y: the area, normalised by the budget."""
    if not budget > 0:
        raise ValueError(f"the budget must be above 0, got {budget}")
    inside = x[(x > 0) & (x < budget)]
    places = np.concatenate([[0.0], inside, [budget]])
    return float(np.trapezoid(on_axis(x, y, places), places) / budget)


def curve_band(
    strata: Sequence[np.ndarray],  # one [n, G] per scene: the curves of its runs on one axis
    statistic: Statistic = mean,
    *,
    level: float = LEVEL,
    repeats: int = BAND_REPEATS,
    seed: int = 0,
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:  # [G] each
    """The statistic at every place, and its pointwise interval; whole runs are drawn again, so places hang together.

    No interval (None, None) where a scene has a single run, or without resamples.
    """
    columns = [pooled([curves[:, place] for curves in strata]) for place in range(strata[0].shape[1])]
    values, sizes = np.stack([column for column, _ in columns]), columns[0][1]  # [G, N]
    line = statistic(values, sizes)
    if min(sizes) < 2 or not repeats:
        return line, None, None
    low, high = interval(statistic(values[:, stratified_draws(sizes, repeats, seed)], sizes), level)
    return line, low, high
