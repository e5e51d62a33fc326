"""Build the page's sections of tables: all policies, sweep, quality by scene, differences, costs, published."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from activestructure_gym.evaluation.report.charts.plots import Bar, interval_chart, legend_marker
from activestructure_gym.evaluation.report.charts.sweep import sweep_charts
from activestructure_gym.evaluation.report.html import html_table, render
from activestructure_gym.evaluation.report.page.method_text import metric_definitions, missing_value_texts
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.report.style import COLOURS
from activestructure_gym.evaluation.report.tables import verdicts
from activestructure_gym.evaluation.report.tables.columns import MAIN, Column, aspects, measured
from activestructure_gym.evaluation.report.tables.layout import Table
from activestructure_gym.evaluation.report.tables.paper import ablation_table, quality_table
from activestructure_gym.evaluation.report.tables.sweep import sweep_lines, sweep_table


def policies_section(results: Results) -> Markup:
    """Return the section of all policies as HTML: a table for each aspect, and the definitions of the metrics."""
    first, *others = [
        html_table(ablation_table(results, aspect), colours=results.palette) for aspect in aspects(results.runs)
    ]
    return render(
        "policies.html.j2",
        first=first,
        others=others,
        definitions=metric_definitions(results),
        missing_value_texts=missing_value_texts(results),
    )


def sweep_section(results: Results) -> Markup | None:
    """Return the section of a sweep as HTML: charts and table with the first swept field as x; None without a sweep."""
    table = sweep_table(results)
    if table is None:
        return None
    first, *others = results.sweep
    caption = (
        f"Means over scenes and seeds at each value of {first}; bars: plus and minus one standard error, with two or "
        "more seeds."
    )
    if others:
        caption += f" Each line has one value of {' and '.join(others)}."
    lines = list(sweep_lines(results))
    return render(
        "sweep.html.j2",
        caption=caption,
        legend=[(name, legend_marker(index)) for index, name in enumerate(lines[: len(COLOURS)])],
        grey=len(lines[len(COLOURS) :]),
        charts=sweep_charts(results),
        table=html_table(table),
    )


def quality_section(results: Results) -> Markup | None:
    """Return the section of quality as HTML: metrics by scene, and mean, median and interquartile mean.

    Return None for a single scene and a single seed.
    """
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
    """Return the section of differences to the baseline as HTML.

    Return None if there is nothing to compare, or for one scene without intervals.
    """
    table = verdicts.difference_table(results)
    intervals = verdicts.has_intervals(results)
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
    """Return title and chart of all policies' differences to the baseline in one metric; None if there are none."""
    bars = [
        Bar(policy, results.palette.index(policy), d.value, d.low, d.high, verdicts.verdict(pair, column)[1])
        for policy, pair in verdicts.differences(results, column).items()
        if (d := pair.difference)
    ]
    if not bars:
        return None
    title = f"{column.title}: difference to {results.baseline}"
    label = f"{column.header} [{column.unit}], {'left' if column.sign < 0 else 'right'} is better"
    return title, interval_chart(bars, title=title, x_label=label)


def costs_section(results: Results) -> Markup:
    """Return the section of costs as HTML: frames, path length, decisions, seconds and others."""
    return render("costs.html.j2", table=html_table(verdicts.cost_table(results), colours=results.palette))


def published_section(tables: Sequence[Table]) -> Markup | None:
    """Return the section with tables of published values as HTML; None without tables."""
    if not tables:
        return None
    return render("published.html.j2", tables=[html_table(table) for table in tables])
