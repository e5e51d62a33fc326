"""Build the planning table: speed of exploration, and improvement in the second half of the budget."""

from __future__ import annotations

from typing import TYPE_CHECKING

from activestructure_gym.evaluation.report.results import Results, once
from activestructure_gym.evaluation.report.tables.columns import (
    LOWER_BOUND,
    PROGRESS,
    Column,
    is_lower_bound,
    measured,
    unreached_levels_text,
)
from activestructure_gym.evaluation.report.tables.layout import MISSING, Cell, Heading, Table, ranked, with_interval
from activestructure_gym.evaluation.report.tables.overview import empty_rich_table, styled
from activestructure_gym.evaluation.statistics import estimate

if TYPE_CHECKING:
    from rich.table import Table as RichTable

_LEVELS = [column.key for column in PROGRESS if column.key.startswith(LOWER_BOUND)]  # from low to high levels


@once
def planning_table(results: Results) -> Table | None:
    """Return the planning table: a row per policy and a column per planning metric, with 95 % intervals.

    The number of frames to a level (a share of the surface) is a mean over runs. A run that did not reach the level
    counts with the frame budget, and the mean gets the prefix ``>``. A policy that never reached the level has no rank.
    Return None if no run has planning metrics.
    """
    columns = measured(PROGRESS, results.runs)
    if not columns:
        return None
    by_column = [
        ranked([_cell(results, policy, column) for policy in results.policies], column, results.planners)
        for column in columns
    ]
    rows = [[Cell(policy), *(cells[k] for cells in by_column)] for k, policy in enumerate(results.policies)]
    caption = (
        "Frames to N %: until N % of the true surface was observed. >: some runs did not reach the share and "
        "count with the budget. Exploration: area under the curve of observed surface, divided by the frame budget. "
        "Late PSNR and late Depth: change per 100 frames in the second half of the budget. Means over scenes of the "
        "means over runs"
    )
    if any(len(results.of(policy, scene)) > 1 for policy in results.policies for scene in results.scenes):
        caption += ", 95 % intervals"
    if missing := unreached_levels_text(results.runs):
        caption += f". {missing}"
    headings = [Heading("Policy", numeric=False), *map(Heading.of, columns)]
    return Table("planning", "Planning", headings, rows, caption)


def rich_planning_table(results: Results) -> RichTable | None:
    """Return a short planning table for the terminal; the best planners are bold and green.

    The number of frames to a level is a mean over runs. A run that did not reach the level counts with the frame
    budget; the cell then has the prefix ``>`` and the number of runs that reached the level. A level that no run
    reached has no column.
    """
    from activestructure_gym.streams import escape

    reached = [key for key in _terminal_levels(results) if not all(is_lower_bound(run, key) for run in results.runs)]
    columns = measured([column for column in PROGRESS if column.key in (*reached, "observed_area")], results.runs)
    if not columns:
        return None
    title = "frames until a share of the surface was observed"
    if not reached and (missing := unreached_levels_text(results.runs)):
        title += f"; {missing[:1].lower()}{missing[1:]}"
    table = empty_rich_table(title)
    table.add_column("policy")
    for column in columns:
        table.add_column(column.title, justify="right")
    by_column = [
        ranked([_short_cell(results, policy, column) for policy in results.policies], column, results.planners)
        for column in columns
    ]
    for policy, *cells in zip(results.policies, *by_column):
        texts = [styled(cell.text, cell.rank == 1) for cell in cells]
        table.add_row(escape(policy), *texts)
    return table


def _terminal_levels(results: Results) -> list[str]:
    """Return the keys of the two levels to print: the highest that half of the runs reached, and the next lower one."""
    reached = [sum(not is_lower_bound(run, key) for run in results.runs) for key in _LEVELS]
    highest = max((at for at, count in enumerate(reached) if 2 * count >= len(results.runs)), default=0)
    return _LEVELS[max(highest - 1, 0) :][:2]


def _short_cell(results: Results, policy: str, column: Column) -> Cell:
    missed = [is_lower_bound(run, column.key) for run in results.of(policy)]
    if missed and all(missed):
        return Cell("not reached")
    strata = results.strata(policy, column.key)
    if strata is None:
        return Cell(MISSING)
    value = estimate(strata).value
    text = f"{value:.{column.digits}f}"
    return Cell(f"> {text} ({len(missed) - sum(missed)} of {len(missed)} runs)" if any(missed) else text, value)


def _cell(results: Results, policy: str, column: Column) -> Cell:
    strata = results.strata(policy, column.key)
    found = None if strata is None else estimate(strata)
    missed = [is_lower_bound(run, column.key) for run in results.of(policy)]
    if found is None or not any(missed):
        return with_interval(found, column)
    budgets = {run.config["configuration"]["frame_budget"] for run in results.of(policy)}
    if all(missed):
        return Cell(f"> {max(budgets)}", note="not reached in any run")
    return Cell(
        f"> {found.value:.{column.digits}f}", found.value, note=f"not reached in {sum(missed)} of {len(missed)} runs"
    )
