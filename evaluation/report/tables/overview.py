"""Build the overview of a comparison: one row per scene and policy, with the best of each scene marked."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.evaluation.archive.jobs import ranked_among, value_text
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report.tables import layout
from activestructure_gym.evaluation.report.tables.columns import Column, overview_columns, value_of
from activestructure_gym.evaluation.report.tables.formats import spreadsheet_text
from activestructure_gym.evaluation.report.tables.layout import Heading, Table

if TYPE_CHECKING:
    from rich.table import Table as RichTable

_HASH_DIGITS = 16  # number of digits of a scene's content hash in CSV
AVERAGE = "average"  # name in the column "scene" for means over the scenes


@dataclass(frozen=True)
class Cell:
    """Hold the mean and the standard deviation of one metric over the seeds."""

    mean: float | None  # None if not defined in any run
    deviation: float | None  # sample standard deviation; None for fewer than two runs
    best: bool = False  # whether it is the best of its scene

    def text(self, digits: int) -> str:
        """Return a text such as ``3.21 ± 0.10`` with ``digits`` decimals, or ``n/a``."""
        if self.mean is None:
            return "n/a"
        if self.deviation is None or (digits == 0 and round(self.deviation) == 0):  # a count that hardly varies
            return f"{self.mean:.{digits}f}"
        return f"{self.mean:.{digits}f} ± {self.deviation:.{digits}f}"


@dataclass(frozen=True)
class Row:
    """Hold the cells of one policy on one scene, or of its average over scenes."""

    scene: str
    policy: str
    runs: int  # number of runs
    cells: dict[str, Cell]  # by the key of the metric
    planner: bool = True  # False for references and given trajectories, which are never marked as best


def table_rows(runs: Sequence[Run]) -> list[Row]:
    """Return one row per scene and policy, in the order of the runs, with the best values of each scene marked.

    If there are several scenes, rows with averages follow, for the policies with runs on all scenes.
    """
    scenes = list(dict.fromkeys(run.scene for run in runs))
    policies = list(dict.fromkeys(run.policy for run in runs))
    ranked = ranked_among({run.job.policy for run in runs})
    columns = overview_columns(runs)
    rows: list[Row] = []
    for scene in scenes:
        block = []
        for policy in policies:
            cell_runs = [r for r in runs if r.scene == scene and r.policy == policy]
            if cell_runs:
                cells = {c.key: _over_runs([value_of(run, c.key) for run in cell_runs]) for c in columns}
                planner = cell_runs[0].job.policy in ranked
                block.append(Row(scene, policy, len(cell_runs), cells, planner))
        rows += _marked(block, columns)
    if len(scenes) > 1:
        complete = [[row for row in rows if row.policy == policy] for policy in policies]
        averages = [_average(block, columns) for block in complete if len(block) == len(scenes)]
        rows += _marked(averages, columns)
    return rows


def empty_rich_table(title: str) -> RichTable:
    """Return an empty table of rich, for the terminal."""
    from rich.table import Table as RichTable

    return RichTable(title=title)


def styled(text: str, best: bool) -> str:
    """Return a text as markup of rich, bold and green if ``best``."""
    return f"[bold green]{text}[/]" if best else text


def rich_table(rows: Sequence[Row], columns: Sequence[Column], *, title: str) -> RichTable:
    """Return a table for the terminal with the given rows and columns; the best numbers are bold and green."""
    from activestructure_gym.streams import escape

    table = empty_rich_table(title)
    table.add_column("scene")
    table.add_column("policy")
    for column in columns:
        table.add_column(column.title, justify="right")
    for index, row in enumerate(rows):
        new_scene = index == 0 or rows[index - 1].scene != row.scene
        ends_block = index + 1 == len(rows) or rows[index + 1].scene != row.scene
        cells = [styled(row.cells[c.key].text(c.digits), row.cells[c.key].best) for c in columns]
        table.add_row(escape(row.scene) if new_scene else "", escape(row.policy), *cells, end_section=ends_block)
    return table


def as_rich_table(table: Table) -> RichTable:
    """Convert a table of the report to a table for the terminal; cells with rank 1 are bold and green."""
    from activestructure_gym.streams import escape

    shown = empty_rich_table(table.title)
    for heading in table.headings:
        shown.add_column(escape(heading.text), justify="right" if heading.numeric else "left")
    for index, row in enumerate(table.rows):
        cells = [styled(escape(table.shown(index, k)), cell.rank == 1) for k, cell in enumerate(row)]
        shown.add_row(*cells, end_section=index + 1 in table.blocks)
    return shown


def overview(rows: Sequence[Row], columns: Sequence[Column], *, name: str = "overview") -> Table:
    """Return the overview as a table of the report, with the ranks 1 to 3 of each scene.

    ``rows`` are those of `table_rows`, and ``name`` is the file name of the table. The column "scene" is left out for a
    single scene.
    """
    blocks = [i for i, row in enumerate(rows) if i and rows[i - 1].scene != row.scene]
    marked: list[list[layout.Cell]] = []
    for start, end in zip([0, *blocks], [*blocks, len(rows)]):
        block = rows[start:end]
        numbers = [
            layout.ranked(
                [layout.Cell(row.cells[c.key].text(c.digits), row.cells[c.key].mean) for row in block],
                c,
                [row.planner for row in block],
            )
            for c in columns
        ]
        names = [[layout.Cell(row.scene) for row in block]] if blocks else []
        names.append([layout.Cell(row.policy) for row in block])
        marked += [list(cells) for cells in zip(*names, *numbers)]
    headings = [Heading("scene", numeric=False)] if blocks else []
    headings += [Heading("policy", numeric=False), *map(Heading.of, columns)]
    title = "All scenes and policies" if blocks else "Results"
    single = all(row.runs == 1 for row in rows if row.scene != AVERAGE)
    caption = "One run per policy" if single else "Mean ± sample standard deviation over seeds"
    if rows and rows[-1].scene == AVERAGE:
        caption += "; the average weights all scenes equally"
    return Table(name, title, headings, marked, caption, blocks=blocks)


def runs_csv(runs: Sequence[Run]) -> str:
    """Return a CSV text with one line per run: swept values, all scalar metrics, and the seconds of each stage."""
    scalars = list(map(_scalars, runs))
    names = list(dict.fromkeys(name for numbers in scalars for name in numbers))
    swept = list(dict.fromkeys(name for run in runs for name in run.job.swept))
    stages = list(dict.fromkeys(stage for run in runs for stage in run.timing.get("seconds", {})))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    titles = ["scene", "scene_hash", "policy", "seed", "preset", "protocol", "job", *swept]
    writer.writerow(map(spreadsheet_text, [*titles, *names, "seconds", *(f"seconds_{stage}" for stage in stages)]))
    for run, numbers in zip(runs, scalars):
        job = run.job
        identity: list[Any] = [run.scene, job.scene_hash[:_HASH_DIGITS], run.policy, job.seed, job.conditions.preset]
        identity += [job.conditions.protocol.name, job.hash]
        identity += [value_text(job.swept_values[name]) if name in job.swept_values else "" for name in swept]
        values: list[Any] = ["" if numbers.get(name) is None else numbers[name] for name in names]
        seconds = [run.timing.get("seconds", {}).get(stage, "") for stage in stages]
        row = [*identity, *values, run.timing["total"], *seconds]
        writer.writerow([spreadsheet_text(value) if isinstance(value, str) else value for value in row])
    return text.getvalue()


def _scalars(run: Run) -> dict[str, Any]:
    """Return the scalar metrics of a run by name, those of further protocols as "PROTOCOL/NAME"."""
    own = run.job.conditions.protocol.name
    further = {
        f"{name}/{key}": value
        for name, content in run.protocols.items() if name != own
        for key, value in content["metrics"].items()
    }  # fmt: skip
    return {key: value for key, value in {**run.numbers, **further}.items() if not isinstance(value, list | dict)}


def _over_runs(values: Sequence[float | None]) -> Cell:
    defined = [float(value) for value in values if value is not None]
    if not defined:
        return Cell(None, None)
    deviation = float(np.std(defined, ddof=1)) if len(defined) > 1 else None
    return Cell(float(np.mean(defined)), deviation)


def _average(block: Sequence[Row], columns: Sequence[Column]) -> Row:
    """Return a policy's row of averages, given its rows of all scenes: means over the scenes, without deviations."""
    cells = {}
    for column in columns:
        means = [row.cells[column.key].mean for row in block]
        cells[column.key] = Cell(None if None in means else float(np.mean([m for m in means if m is not None])), None)
    return Row(AVERAGE, block[0].policy, sum(row.runs for row in block), cells, block[0].planner)


def _marked(block: Sequence[Row], columns: Sequence[Column]) -> list[Row]:
    """Mark the best value of each column among the planners of a block; equal printed values are all marked.

    References are never marked. Nothing is marked if there is a single planner.
    """
    marked = [dict(row.cells) for row in block]
    for column in columns:
        means = {i: row.cells[column.key].mean for i, row in enumerate(block) if row.planner}
        rounded = {i: round(mean, column.digits) for i, mean in means.items() if mean is not None}
        if column.best is None or len(means) < 2 or not rounded:
            continue
        best = min(rounded.values()) if column.best == "lowest" else max(rounded.values())
        for index, value in rounded.items():
            cell = block[index].cells[column.key]
            marked[index][column.key] = Cell(cell.mean, cell.deviation, best=value == best)
    return [replace(row, cells=cells) for row, cells in zip(block, marked)]
