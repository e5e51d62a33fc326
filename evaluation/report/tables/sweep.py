"""Build the table of a sweep: each metric over the values of the first swept field, with one column per policy."""

from __future__ import annotations

from activestructure_gym.evaluation.archive.jobs import value_text
from activestructure_gym.evaluation.report.results import Results, once
from activestructure_gym.evaluation.report.tables.columns import COSTS, MAIN, Column, measured, own_metrics
from activestructure_gym.evaluation.report.tables.layout import Cell, Heading, Table, ranked, with_interval
from activestructure_gym.evaluation.statistics import estimate


@once
def sweep_lines(results: Results) -> dict[str, dict[int, str]]:
    """Return the policies with their values of the other swept fields, each as a line over the first swept field.

    A line maps the index of a value of the first field to the name of the policy with that value in `Results`.
    """
    lines: dict[str, dict[int, str]] = {}
    if results.sweep:
        first = next(iter(results.sweep))
        for run in results.runs:
            others = [f"{name}={value_text(v)}" for name, v in run.job.swept_values.items() if name != first]
            line = lines.setdefault(run.planner + (f" [{', '.join(others)}]" if others else ""), {})
            line[results.sweep[first].index(run.job.swept_values[first])] = run.policy
    return {name: dict(sorted(line.items())) for name, line in lines.items()}


def values_of(results: Results) -> list[str]:
    """Return the values of the first swept field as texts."""
    return [value_text(value) for value in next(iter(results.sweep.values()))]


@once
def sweep_table(results: Results) -> Table | None:
    """Return the table of a sweep, None without one: a row per metric and value of the first swept field.

    A column has a line of `sweep_lines`, with means over the scenes and 95 % intervals. Ranks compare its values.
    """
    if not results.sweep:
        return None
    lines, values = sweep_lines(results), values_of(results)
    # Without ground truth, the main metrics are own metrics of the runs as well.
    columns = {column.key: column for column in (*MAIN, *map(Column.of, own_metrics(results.runs)), COSTS[-1])}
    rows, blocks = list[list[Cell]](), list[int]()
    for column in measured(columns.values(), results.runs):
        by_line = []
        for line in lines.values():
            strata = [results.strata(line[at], column.key) if at in line else None for at in range(len(values))]
            cells = [with_interval(None if one is None else estimate(one), column) for one in strata]
            by_line.append(ranked(cells, column))
        if rows:
            blocks.append(len(rows))
        name = Cell(column.title, note=column.meaning)
        rows += [[name, Cell(value), *cells] for value, *cells in zip(values, *by_line)]
    first, *others = results.sweep
    headings = [Heading("Metric", numeric=False), Heading(first, numeric=False), *map(Heading, lines)]
    caption = (
        "Means over scenes of the means over seeds, with 95 % intervals where every scene has two "
        f"runs. Marked: the best three values of {first} in each column"
    )
    caption += f". Brackets: values of {', '.join(others)}" if others else ""
    return Table("sweep", f"Sweep of {first}", headings, rows, caption, blocks=blocks)
