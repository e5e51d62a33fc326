"""Define tables as data: headings, cells and ranks. The modules `formats` and `html` write tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from activestructure_gym.evaluation.report.tables.columns import Column
from activestructure_gym.evaluation.statistics import Estimate

NONE = "n/a"  # text of a value that is not defined
MISSING = "–"  # text for no finished run, as the paper's "failure to complete"

Judgement = Literal["", "good", "bad"]
Tone = Literal[Judgement, "alarm"]


@dataclass(frozen=True)
class Cell:
    """Hold one cell of a table."""

    text: str
    value: float | None = None  # number by which rows are sorted; None sorts by the text
    rank: int = 0  # 1, 2 or 3; 0 is not marked
    tone: Tone = ""  # colour: good, bad or alarm
    note: str = ""  # tooltip


@dataclass(frozen=True)
class Heading:
    """Hold the heading of one column."""

    text: str
    numeric: bool = True  # whether the column has numbers, which are aligned to the right
    note: str = ""  # tooltip

    @classmethod
    def of(cls, column: Column) -> Heading:
        """Return the heading of the column that describes a metric."""
        return cls(column.title, note=column.meaning)


@dataclass(frozen=True)
class Table:
    """Hold a table: headings, rows of cells, a title and a caption."""

    name: str  # file name without extension
    title: str
    headings: Sequence[Heading]
    rows: Sequence[Sequence[Cell]]
    caption: str = ""
    groups: Sequence[tuple[str, int]] = ()  # row above the headings: texts, each with the number of columns it spans
    blocks: Sequence[int] = field(default=())  # first row of each block but the first; a block repeats no first cell

    @property
    def sortable(self) -> bool:
        """Return whether readers can sort the rows on the page; tables with groups of columns cannot be sorted."""
        return not self.groups and len(self.rows) > 1

    def shown(self, row: int, column: int) -> str:
        """Return the text of a cell; empty for a cell of column 0 that repeats the cell above in the same block."""
        text = self.rows[row][column].text
        if column or not self.blocks or row in self.blocks or row == 0:
            return text
        return "" if self.rows[row - 1][0].text == text else text


def number(value: float | None, digits: int, missing: str = NONE) -> Cell:
    """Return a cell with ``value`` and ``digits`` decimals, or with the text ``missing`` for None."""
    return Cell(missing) if value is None else Cell(f"{value:,.{digits}f}", value)


def with_interval(estimate: Estimate | None, column: Column, *, signed: bool = False) -> Cell:
    """Return a cell such as ``3.21 [3.02, 3.40]``; the interval is left out if there is none.

    ``signed`` is for differences: it adds a plus sign to positive numbers. Otherwise the interval of a percentage
    between 0 and 100 ends there. None gives the text `MISSING`.
    """
    if estimate is None:
        return Cell(MISSING)
    text = decimal(estimate.value, column.digits, signed=signed)
    if estimate.low is not None and estimate.high is not None:
        ends = [estimate.low, estimate.high]
        if column.unit == "%" and not signed and 0.0 <= estimate.value <= 100.0:
            ends = [min(max(end, 0.0), 100.0) for end in ends]
        text += f" [{', '.join(decimal(end, column.digits, signed=signed) for end in ends)}]"
    return Cell(text, estimate.value)


def decimal(value: float, digits: int, *, signed: bool = False) -> str:
    """Format a number with ``digits`` decimals and a typographic minus sign; zero has no sign."""
    rounded = round(value, digits) or 0.0
    return f"{rounded:{'+' if signed and rounded else ''}.{digits}f}".replace("-", "−")


def ranked(cells: Sequence[Cell], column: Column, planners: Sequence[bool] | None = None) -> list[Cell]:
    """Return the cells of a column with ranks 1 to 3; equal printed values share a rank, and a single value has none.

    ``planners`` says for each cell whether it takes part in the ranking, in which references do not; None ranks all.
    """
    is_ranked = [True] * len(cells) if planners is None else planners
    values = {
        i: round(cell.value, column.digits)
        for i, (cell, included) in enumerate(zip(cells, is_ranked, strict=True))
        if included and cell.value is not None
    }
    if column.best is None or len(values) < 2:
        return list(cells)
    order = sorted(values.values(), reverse=column.best == "highest")
    return [
        replace(cell, rank=rank) if i in values and (rank := order.index(values[i]) + 1) <= 3 else cell
        for i, cell in enumerate(cells)
    ]
