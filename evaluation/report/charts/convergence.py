"""Compute and draw convergence curves: completion ratio, observed surface and PSNR over frames, metres or seconds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.protocols.metrics import Metric, standard
from activestructure_gym.evaluation.protocols.metrics.without_truth import KEYFRAME_PSNR, KNOWN_VOLUME
from activestructure_gym.evaluation.report.charts.plots import Line, line_chart, value_range
from activestructure_gym.evaluation.report.results import Results, once
from activestructure_gym.evaluation.report.style import is_grey
from activestructure_gym.evaluation.statistics import Statistic, area_under, curve_band, mean, on_axis

_POINTS = 61  # number of positions on the common horizontal axis
_SETTLED = 0.01  # share of the chart's height; a curve has settled once it stays this close to its last value
_TAIL = 0.5  # share of a chart's width; if all curves settle before it, the chart is cut after they have settled


@dataclass(frozen=True)
class Measure:
    """Define a quantity on the vertical axis of convergence curves."""

    metric: Metric
    label: str  # of the axis

    @property
    def key(self) -> str:
        """Return the name of the metric, which is also its field in the list ``curve`` of metrics.json."""
        return self.metric.name


@dataclass(frozen=True)
class Cost:
    """Define a cost on the horizontal axis of convergence curves."""

    key: str  # field in the list ``curve`` of metrics.json, or "seconds"
    label: str  # of the axis


MEASURES = (
    Measure(standard.RATIO, "C.R. at 5 cm [%]"),
    Measure(standard.OBSERVED, "surface observed [%]"),
    Measure(standard.PSNR, "PSNR of held-out views [dB]"),
    Measure(KNOWN_VOLUME, "known volume [m³]"),
    Measure(KEYFRAME_PSNR, "PSNR of keyframes [dB]"),
)
COSTS = (Cost("frames", "frames"), Cost("metres", "path length [m]"), Cost("seconds", "wall clock [s]"))


def curve_of(run: Run, cost: str, measure: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the costs [P] and values [P] of one run's curve, at the P points where ``measure`` was taken.

    Costs increase strictly: of several points with the same cost, the last one is used. The cost "seconds" is the wall
    time at the end of a decision, without evaluation, and 0 before the first one.
    """
    points: dict[float, float] = {}
    for point in run.metrics["curve"]:
        if point.get(measure) is None:
            continue
        if cost == "seconds":
            ended = run.timing.get("decisions", [])
            if point["decision"] > len(ended):
                continue
            points[ended[point["decision"] - 1] if point["decision"] else 0.0] = point[measure]
        else:
            points[point[cost]] = point[measure]
    places = sorted(points)
    return np.array(places, dtype=np.float64), np.array([points[place] for place in places], dtype=np.float64)


@once
def measures_of(results: Results) -> list[Measure]:
    """Return the measures for which at least one run has a curve."""
    return [m for m in MEASURES if any(p.get(m.key) is not None for run in results.runs for p in run.metrics["curve"])]


@once
def convergence(
    results: Results,
    cost: str,
    measure: str,
    scene: str | None = None,
    statistic: Statistic = mean,
    until: float = math.inf,
    banded: bool = True,
) -> list[Line]:
    """Return one line per policy: ``statistic`` over its runs, on ``scene`` or over all scenes.

    ``cost`` and ``measure`` are keys of `COSTS` and `MEASURES`. Curves are interpolated at common positions; a run that
    has ended keeps its last value. A line begins where all runs of the policy have begun, and ends with its longest run
    or at the cost ``until``; its band is plus and minus one standard error. Policies without a curve on every scene are
    left out. Policies drawn in grey have a band only if ``banded``.
    """
    lines = []
    scenes = [scene] if scene else results.scenes
    for policy in results.policies:
        strata = [_curves(results.of(policy, own), cost, measure) for own in scenes]
        if not all(strata):
            continue
        curves = [curve for own in strata for curve in own]
        start, end = max(x[0] for x, _ in curves), max(x[-1] for x, _ in curves)
        axis = np.linspace(start, max(start, min(end, until)), _POINTS)
        on_one = [np.stack([on_axis(x, y, axis) for x, y in own]) for own in strata]
        index = results.palette.index(policy)
        band = curve_band(on_one, statistic, banded=banded or not is_grey(index))
        lines.append(Line(policy, index, axis, *band))
    return lines


@once
def chart_rows(results: Results, scene: str | None = None, statistic: Statistic = mean) -> list[list[Markup]]:
    """Return the convergence charts: a row per measure and a column per cost, with one vertical axis per row.

    They are of ``scene``, or of all scenes for None. ``statistic`` aggregates the runs of a policy.
    """
    rows = []
    for measure in measures_of(results):
        curves = [_trimmed(results, cost, measure, scene, statistic) for cost in COSTS]
        values = value_range([line for lines in curves for line in lines])
        rows.append([
            line_chart(
                lines,
                title=f"{measure.label} over {cost.label}, {scene or 'all scenes'}",
                x_label=cost.label,
                y_label=measure.label,
                y_includes=values,
            )
            for cost, lines in zip(COSTS, curves)
        ])  # fmt: skip
    return rows


def _trimmed(results: Results, cost: Cost, measure: Measure, scene: str | None, statistic: Statistic) -> list[Line]:
    """Return the lines of `convergence`, cut 10 % after the cost at which all of them have settled.

    Curves over frames are not cut, since the budget is in frames.
    """
    lines = convergence(results, cost.key, measure.key, scene, statistic, banded=False)
    if cost.key == "frames" or not lines:
        return lines
    low, high = value_range(lines)
    settled = max(_settled(line, _SETTLED * (high - low)) for line in lines)
    if not max(line.x[0] for line in lines) < settled < _TAIL * max(line.x[-1] for line in lines):
        return lines
    return convergence(results, cost.key, measure.key, scene, statistic, until=1.1 * settled, banded=False)


def _settled(line: Line, within: float) -> float:
    """Return the cost from which on a line and its band differ from their last values by at most ``within``."""
    moving = [np.flatnonzero(np.abs(y - y[-1]) > within) for y in (line.y, line.low, line.high) if y is not None]
    last = max((int(places[-1]) for places in moving if len(places)), default=-1)
    return float(line.x[min(last + 1, len(line.x) - 1)])


def areas(results: Results, policy: str, cost: str, measure: str) -> list[np.ndarray] | None:
    """Return the areas under the curves of a policy's runs, one array per scene; None if a scene has no curve.

    ``cost`` and ``measure`` are keys of `COSTS` and `MEASURES`. An area is divided by the budget, so it is a mean in
    the unit of ``measure``. The budget is the frame budget, or for metres and seconds the lowest total above 0 of any
    run on the scene.
    """
    strata = []
    for scene in results.scenes:
        all_curves = _curves(results.of(None, scene), cost, measure)
        own = _curves(results.of(policy, scene), cost, measure)
        if not own:
            return None
        totals = [float(x[-1]) for x, _ in all_curves if x[-1] > 0]
        if cost == "frames":
            totals = [max(float(run.config["configuration"]["frame_budget"]) for run in results.of(None, scene))]
        if not totals:
            return None
        strata.append(np.array([area_under(x, y, min(totals)) for x, y in own]))
    return strata


def _curves(runs: Sequence[Run], cost: str, measure: str) -> list[tuple[np.ndarray, np.ndarray]]:
    return [curve for run in runs if len((curve := curve_of(run, cost, measure))[0])]
