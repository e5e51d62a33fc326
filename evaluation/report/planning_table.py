"""The table of planning: how soon the surface was seen, and what the second half of the frames was worth."""

from __future__ import annotations

from dataclasses import replace

from activestructure_gym.evaluation.report.columns import PROGRESS, Column, exceeded, measured
from activestructure_gym.evaluation.report.layout import Cell, Heading, Table, ranked, with_interval
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.statistics import estimate


def planning_table(results: Results) -> Table | None:
    """A row per policy, a column per metric of planning, with 95 % intervals; None where no run was measured so.

    Frames to a level are a mean in which the budget stands for every run that did not reach it, after a ``>`` then; a
    policy of which no run did has no rank.
    """
    columns = measured(PROGRESS, results.runs)
    if not columns:
        return None
    by_column = [ranked([_cell(results, policy, column) for policy in results.policies], column) for column in columns]
    rows = [[Cell(policy), *(cells[k] for cells in by_column)] for k, policy in enumerate(results.policies)]
    caption = (
        "Frames until that share of the observable surface was observed (> : runs that did not reach it count with the "
        "budget); mean height of the curve of what was observed, over the frame budget; change of PSNR and of the "
        "depth error in the curve's views from half the budget on, per 100 frames. Means over the scenes of the mean "
        "over their runs, 95 % stratified bootstrap intervals"
    )
    headings = [Heading("Policy", numeric=False), *map(Heading.of, columns)]
    return Table("planning", "Planning", headings, rows, caption)


def _cell(results: Results, policy: str, column: Column) -> Cell:
    strata = results.strata(policy, column.key)
    cell = with_interval(None if strata is None else estimate(strata), column.digits)
    missed = [exceeded(run, column.key) for run in results.of(policy)]
    if strata is None or not any(missed):
        return cell
    budgets = {run.config["configuration"]["frame_budget"] for run in results.of(policy)}
    if all(missed):
        return Cell(f"> {max(budgets)}", note="reached in no run")
    return replace(cell, text=f"> {cell.text}", note=f"not reached in {sum(missed)} of {len(missed)} runs")
