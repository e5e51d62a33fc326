"""Interpolate convergence curves of runs on a common axis, and compute their band and the area below."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from activestructure_gym.evaluation.statistics.aggregates import Statistic, mean
from activestructure_gym.evaluation.statistics.intervals import pooled, standard_error


def on_axis(x: np.ndarray, y: np.ndarray, axis: np.ndarray) -> np.ndarray:  # [P], [P], [G] -> [G]
    """Return the values of the curve (``x``, ``y``) at the positions ``axis``, by linear interpolation.

    Before the first point the curve has its first value. After the last point it has its last value, since the map of a
    finished episode does not change. Raise `ValueError` if there is no point or ``x`` does not increase strictly.
    """
    if len(x) < 1 or np.any(np.diff(x) <= 0):
        raise ValueError("a curve needs at least one point, and costs that rise strictly")
    return np.interp(axis, x, y)


def area_under(x: np.ndarray, y: np.ndarray, budget: float) -> float:
    """Return the mean height of the curve (``x``, ``y``) from 0 to ``budget``, in the unit of ``y``.

    This is the area under the curve divided by ``budget``, which has the unit of ``x``. Raise `ValueError` if
    ``budget`` is not above 0.
    """
    if not budget > 0:
        raise ValueError(f"the budget must be above 0, got {budget}")
    inside = x[(x > 0) & (x < budget)]
    places = np.concatenate([[0.0], inside, [budget]])
    return float(np.trapezoid(on_axis(x, y, places), places) / budget)


def curve_band(
    strata: Sequence[np.ndarray],  # one array [n, G] per scene: n runs, G positions on a common axis
    statistic: Statistic = mean,
    *,
    banded: bool = True,
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:  # [G] each
    """Return ``statistic`` at every position of the axis, and there minus and plus its standard error.

    The ends are None if a scene has a single run or not ``banded``.
    """
    columns = [pooled([curves[:, place] for curves in strata]) for place in range(strata[0].shape[1])]
    values, sizes = np.stack([column for column, _ in columns]), columns[0][1]  # [G, N]
    line = statistic(values, sizes)
    if min(sizes) < 2 or not banded:
        return line, None, None
    error = standard_error(values, sizes, statistic)
    return line, line - error, line + error
