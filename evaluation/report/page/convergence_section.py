"""Build the page's convergence section, and the grid of charts that the sections of single scenes use too."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from activestructure_gym.evaluation.report import style
from activestructure_gym.evaluation.report.charts.convergence import (
    COSTS,
    Measure,
    chart_rows,
    convergence,
    measures_of,
)
from activestructure_gym.evaluation.report.charts.plots import Line, legend_marker, panel_chart
from activestructure_gym.evaluation.report.html import html_table, render
from activestructure_gym.evaluation.report.results import Results, once
from activestructure_gym.evaluation.report.tables import verdicts
from activestructure_gym.evaluation.report.tables.planning import planning_table
from activestructure_gym.evaluation.statistics import Statistic, interquartile_mean, mean


def convergence_section(results: Results) -> Markup:
    """Return the convergence section as HTML.

    It has a legend by which readers hide curves, the curves over all scenes, the planning table, and the areas under
    the curves.
    """
    seeds, scenes = len(results.seeds), len(results.scenes)
    caption = "Mean over scenes and seeds" if scenes > 1 else "Mean over seeds" if seeds > 1 else "One run per policy"
    planning = planning_table(results)
    caption += "; band: plus and minus one standard error" if seeds > 1 else "; no band with one seed"
    return render(
        "convergence.html.j2",
        legend=[(policy, legend_marker(index)) for index, policy in enumerate(results.palette[: len(style.COLOURS)])],
        rest=results.palette[len(style.COLOURS) :],
        caption=caption,
        charts=chart_grid(results),
        panels=policy_panels(results),
        interquartile=chart_grid(results, None, interquartile_mean) if seeds > 1 else None,
        planning=None if planning is None else html_table(planning, colours=results.palette),
        areas=html_table(verdicts.area_table(results), colours=results.palette),
    )


def chart_grid(results: Results, scene: str | None = None, statistic: Statistic = mean) -> Markup:
    """Return the charts of all measures over frames, metres and seconds, with a sentence on the best policies each.

    The charts are of ``scene``, or of all scenes for None; ``statistic`` aggregates runs.
    """
    ranked = {name for name, planner in zip(results.policies, results.planners) if planner}

    def compared(measure: Measure) -> list[Line]:
        lines = convergence(results, COSTS[0].key, measure.key, scene, statistic, banded=False)
        return [line for line in lines if line.name in ranked]

    rows = [
        (reading(compared(measure), measure), charts)
        for measure, charts in zip(measures_of(results), chart_rows(results, scene, statistic), strict=True)
    ]
    return render("chart_grid.html.j2", rows=rows)


def reading(lines: Sequence[Line], measure: Measure) -> str:
    """Return a sentence that names the policies with the highest curves at half of the frames and at the end.

    Values that are equal as printed are ties. All lines are of one measure, over frames.
    """
    if not lines:
        return ""
    half = 0.5 * max(float(line.x[-1]) for line in lines)
    ends = {line.name: f"{line.y[-1]:.{measure.metric.digits}f}" for line in lines}
    middles = {line.name: f"{np.interp(half, line.x, line.y):.{measure.metric.digits}f}" for line in lines}
    best, early = (max(map(float, found.values())) for found in (ends, middles))
    last, first = (
        [name for name, text in found.items() if float(text) == top] for found, top in ((ends, best), (middles, early))
    )
    top, before = (f"{value:.{measure.metric.digits}f} {measure.metric.unit}" for value in (best, early))
    if len(lines) == 1:
        return f"{measure.metric.label}: {before} at frame {half:.0f}, {top} at the end."
    middle = f"at frame {half:.0f}: {_named(first)} ({before})"
    return f"{measure.metric.label}, highest at the end: {_named(last)} ({top}), {middle}."


def _named(names: Sequence[str]) -> str:
    shown = ", ".join(names[:3]) if len(names) != 2 else " and ".join(names)
    return shown + (f" and {len(names) - 3} more" if len(names) > 3 else "")


@once
def policy_panels(results: Results) -> list[Markup]:
    """Return one chart per measure over frames, with a panel per policy; empty if all policies have a colour."""
    if len(results.policies) <= len(style.COLOURS):
        return []
    frames = COSTS[0]
    return [
        panel_chart(
            convergence(results, frames.key, measure.key),
            title=f"{measure.label} over {frames.label}, one panel per policy",
            x_label=frames.label,
            y_label=measure.label,
        )
        for measure in measures_of(results)
    ]
