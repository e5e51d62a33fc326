"""Print the result of a comparison in a terminal: one line per policy, and as many columns as fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.table import Table

from activestructure_gym.errors import pluralised
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.cli.fitting import fits
from activestructure_gym.evaluation.cli.output import plain_table, print_whole, width_of
from activestructure_gym.evaluation.report.tables.columns import (
    Column,
    measured,
    overview_columns,
    own_metrics,
    value_of,
)
from activestructure_gym.evaluation.report.tables.overview import AVERAGE, Cell, Row, rich_table, styled, table_rows
from activestructure_gym.streams import escape

_LOG = 80  # width of tables in a log, in characters
# Columns that are always shown, together with the runs' own metrics; and columns that are added as long as they fit.
_MAIN = ("observed", "completion_ratio", "psnr", "metres", "seconds")
_MORE = ("tsdf_completion_ratio", "ssim", "completion_cm", "accuracy_cm", "precision", "frames")


def print_result(console: Console, runs: Sequence[Run], *, wide: bool) -> bool:
    """Print one line per policy, or with ``wide`` all columns for every scene.

    Return whether columns or scenes are left out.
    """
    if wide:
        print_whole(console, rich_table(table_rows(runs), overview_columns(runs), title=_title(runs)), wide=True)
        return False
    tables = result_tables(runs, width_of(console) or _LOG)
    for table in tables:
        print_whole(console, table)
    shown = len(tables[0].columns) - 1
    return shown < len(overview_columns(runs)) or len({run.scene for run in runs}) > len(tables)


def result_tables(runs: Sequence[Run], width: int) -> list[Table]:
    """Return one table of means over the scenes, or one table per scene if a policy has not run in all scenes.

    ``width`` is the width of the terminal in characters.
    """
    rows = table_rows(runs)
    scenes = list(dict.fromkeys(run.scene for run in runs))
    averages = [_with_deviation(row, runs) for row in rows if row.scene == AVERAGE]
    main = (*_MAIN[:3], *(metric.name for metric in own_metrics(runs)), *_MAIN[3:])
    columns = {column.key: column for column in measured(overview_columns(runs), runs)}
    first, more = ([columns[key] for key in keys if key in columns] for keys in (main, _MORE))
    if len(averages) == len({run.policy for run in runs}):
        return [_fitting(averages, _title(runs), first, more, width)]
    blocks = {scene: [row for row in rows if row.scene == scene] for scene in scenes}
    return [
        _fitting(block, f"{scene}: {_title([run for run in runs if run.scene == scene])}", first, more, width)
        for scene, block in blocks.items()
    ]


def _with_deviation(row: Row, runs: Sequence[Run]) -> Row:
    """Add standard deviations to a policy's row of averages: over the seeds, of the mean over the scenes.

    A metric gets no deviation if a seed lacks a run on a scene, or a value.
    """
    cells = dict(row.cells)
    own = [run for run in runs if run.policy == row.policy]
    scenes = {run.scene for run in own}
    for key, cell in cells.items():
        by_seed: dict[int, dict[str, float]] = {}
        for run in own:
            values = by_seed.setdefault(run.job.seed, {})
            if (value := value_of(run, key)) is not None:
                values[run.scene] = value
        if len(by_seed) > 1 and all(values.keys() == scenes for values in by_seed.values()):
            means = [np.mean(list(values.values())) for values in by_seed.values()]
            cells[key] = replace(cell, deviation=float(np.std(means, ddof=1)))
    return replace(row, cells=cells)


def _fitting(rows: Sequence[Row], title: str, first: Sequence[Column], more: Sequence[Column], width: int) -> Table:
    """Return a table of ``rows`` with the columns ``first``, and as many columns of ``more`` as fit into ``width``."""
    for count in range(len(more), -1, -1):
        table = _table(rows, title, [*first, *more[:count]])
        if fits(table, width):
            break
    return table


def _table(rows: Sequence[Row], title: str, columns: Sequence[Column]) -> Table:
    table = plain_table(escape(title), "policy")
    for column in columns:
        table.add_column(column.title, justify="right")
    for row in rows:
        table.add_row(escape(row.policy), *(_shown(row.cells[column.key], column) for column in columns))
    return table


def _shown(cell: Cell, column: Column) -> str:
    digits = 0 if column.key == "seconds" else column.digits
    return styled(cell.text(digits), cell.best)


def _title(runs: Sequence[Run]) -> str:
    """Return the title of a table, which says over how many scenes and seeds its numbers are averaged."""
    scenes, seeds = len({run.scene for run in runs}), len({run.job.seed for run in runs})
    mean = f"mean of {pluralised(scenes, 'scene')}" if scenes > 1 else "mean"
    if seeds > 1:
        return f"{mean} ± standard deviation over {pluralised(seeds, 'seed')}"
    return f"{mean}, one seed" if scenes > 1 else "one seed"
