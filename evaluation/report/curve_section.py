"""The part of the page about convergence: curves of all scenes together, and the charts that a scene's part has too."""

from __future__ import annotations

from markupsafe import Markup

from activestructure_gym.evaluation.report import style, verdicts
from activestructure_gym.evaluation.report.charts import key_mark, panel_chart
from activestructure_gym.evaluation.report.curves import COSTS, chart_rows, convergence, measures_of
from activestructure_gym.evaluation.report.html import html_table, render
from activestructure_gym.evaluation.report.planning_table import planning_table
from activestructure_gym.evaluation.report.results import Results, once
from activestructure_gym.evaluation.statistics import Statistic, interquartile_mean, mean


def convergence_section(results: Results) -> Markup:
    """Curves with a legend that hides them everywhere, and the areas below them."""
    seeds, scenes = len(results.seeds), len(results.scenes)
    says = "Mean over all scenes and seeds" if scenes > 1 else "Mean over the seeds" if seeds > 1 else "One run each"
    planning = planning_table(results)
    says += ", band: 95 % bootstrap interval at every place" if seeds > 1 else "; no band with one seed"
    return render(
        "convergence.html.j2",
        legend=[(policy, key_mark(index)) for index, policy in enumerate(results.palette[: len(style.COLOURS)])],
        rest=results.palette[len(style.COLOURS) :],
        says=says,
        charts=chart_grid(results),
        panels=policy_panels(results),
        interquartile=chart_grid(results, None, interquartile_mean) if seeds > 1 else None,
        planning=None if planning is None else html_table(planning, colours=results.palette),
        areas=html_table(verdicts.area_table(results), colours=results.palette),
    )


def chart_grid(results: Results, scene: str | None = None, statistic: Statistic = mean) -> Markup:
    """All measures over frames, metres and seconds."""
    charts = [chart for row in chart_rows(results, scene, statistic) for chart in row]
    return render("chart_grid.html.j2", charts=charts)


@once
def policy_panels(results: Results) -> list[Markup]:
    """All measures over the frames with a panel for each policy; none while colours tell all policies apart."""
    if len(results.policies) <= len(style.COLOURS):
        return []
    frames = COSTS[0]
    return [
        panel_chart(
            convergence(results, frames.key, measure.key),
            title=f"{measure.label} over {frames.label}, policy by policy",
            x_label=frames.label,
            y_label=measure.label,
        )
        for measure in measures_of(results)
    ]
