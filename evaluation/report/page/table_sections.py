"""The parts of the page that are tables: quality on every scene, differences to the baseline, costs."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from activestructure_gym.evaluation.report.charts.plots import Bar, interval_chart
from activestructure_gym.evaluation.report.html import html_table, render
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.report.tables import verdicts
from activestructure_gym.evaluation.report.tables.columns import MAIN, Column, aspects, measured
from activestructure_gym.evaluation.report.tables.layout import Table
from activestructure_gym.evaluation.report.tables.paper import quality_table


def quality_section(results: Results) -> Markup | None:
    """Quality on single scenes, and by other statistics than the mean."""
    if len(results.scenes) == 1 and len(results.seeds) == 1:
        return None
    tables = []
    if len(results.scenes) > 1:
        tables = [
            (aspect.title, html_table(quality_table(results, aspect, average=False), colours=results.palette))
            for aspect in aspects(results.runs)
        ]
    return render(
        "quality.html.j2",
        first=tables[0][1] if tables else None,
        rows=len(results.policies) * len(aspects(results.runs)[0].columns),
        others=tables[1:],
        aggregates=html_table(verdicts.aggregate_table(results)),
    )


def differences_section(results: Results) -> Markup | None:
    """Differences to the baseline; nothing where a single pair is all there is, which stands at a glance."""
    table = verdicts.difference_table(results)
    intervals = verdicts.can_tell(results)
    if table is None or (len(results.scenes) == 1 and not intervals):
        return None
    columns = measured(MAIN, results.runs) if intervals else ()
    charts = [_intervals(results, column) for column in columns]
    matrices = [verdicts.improvement_table(results, column) for column in columns]
    return render(
        "differences.html.j2",
        baseline=results.baseline,
        intervals=intervals,
        charts=[chart for chart in charts if chart is not None],
        table=html_table(table, colours=results.palette),
        rows=len(table.rows),
        matrices=[html_table(matrix, colours=results.palette) for matrix in matrices if matrix is not None],
    )


def _intervals(results: Results, column: Column) -> tuple[str, Markup] | None:
    """A title and a chart of every policy's difference to the baseline; None where there is none."""
    bars = [
        Bar(policy, results.palette.index(policy), d.value, d.low, d.high, verdicts.verdict(pair, column)[1])
        for policy, pair in verdicts.differences(results, column).items()
        if (d := pair.difference)
    ]
    if not bars:
        return None
    title = f"{column.title}: difference to {results.baseline}"
    label = f"{column.header} [{column.unit}], better is {'left' if column.sign < 0 else 'right'}"
    return title, interval_chart(bars, title=title, x_label=label)


def costs_section(results: Results) -> Markup:
    """Path, decisions and seconds."""
    return render("costs.html.j2", table=html_table(verdicts.cost_table(results), colours=results.palette))


def published_section(tables: Sequence[Table]) -> Markup | None:
    """Tables of published values with the runs beside them; nothing without any."""
    if not tables:
        return None
    return render("published.html.j2", tables=[html_table(table) for table in tables])
