"""Draw the charts of a sweep: a metric over the values of the first swept field, with one line per policy."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from activestructure_gym.evaluation.report.charts.plots import Line, line_chart, shortened
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.report.tables.columns import MAIN, Column, measured
from activestructure_gym.evaluation.report.tables.sweep import sweep_lines, values_of
from activestructure_gym.evaluation.statistics import estimate

_CHARTED = ("completion_ratio", "psnr")
_CHARACTERS = 48  # of all tick labels of a horizontal axis together
_CLOSE = 0.1  # values closer than this share of their range are spaced equally
_SHIFT = 0.012  # horizontal distance of two lines as a share of the axis, so that their intervals do not overlap


def sweep_charts(results: Results) -> list[tuple[str, Markup]]:
    """Return title and chart of C.R. and PSNR, or else of the first two main metrics; empty without a sweep.

    A point is a mean over scenes and seeds; its bar is plus and minus one standard error.
    """
    if not results.sweep:
        return []
    name = next(iter(results.sweep))
    columns = measured(MAIN, results.runs)
    chosen = [column for column in columns if column.key in _CHARTED] or columns[:2]
    texts, places = values_of(results), _places(results.sweep[name])
    letters = max(3, _CHARACTERS // len(texts))
    labels = {place: shortened(text, letters) for text, place in zip(texts, places)}
    charts = []
    for column in chosen:
        title = f"{column.title} over {name}"
        drawn = line_chart(
            _lines(results, column, places), title=title, x_label=name, y_label=column.title, x_labels=labels
        )
        charts.append((title, drawn))
    return charts


def _lines(results: Results, column: Column, places: np.ndarray) -> list[Line]:
    lines = []
    named = sweep_lines(results)
    for index, (name, rows) in enumerate(named.items()):
        found = {at: own for at, row in rows.items() if (own := results.strata(row, column.key)) is not None}
        if not found:
            continue
        means = [estimate(own) for own in found.values()]
        shift = _SHIFT * (np.ptp(places) or 1.0) * (index - 0.5 * (len(named) - 1))
        y = np.array([one.value for one in means])
        error = np.array([one.error or 0.0 for one in means])
        lines.append(Line(name, index, places[list(found)] + shift, y, y - error, y + error))
    return lines


def _places(values: list[object]) -> np.ndarray:
    """Return the horizontal positions of the values: numbers to scale, others and close ones equally spaced."""
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
        places = np.array(values, np.float64)
        if len(places) > 1 and np.diff(places).min() >= _CLOSE * np.ptp(places):
            return places
    return np.arange(len(values), dtype=np.float64)
