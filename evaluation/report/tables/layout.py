"""Define tables as data: headings, cells, ranks. `formats` and `html` write them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from activestructure_gym.evaluation.report.tables.columns import Column
from activestructure_gym.evaluation.statistics import Estimate

NONE = "n/a"  # undefined value
MISSING = "–"  # no finished run; the paper's "failure to complete"

Judgement = Literal["", "good", "bad"]
Tone = Literal[Judgement, "alarm"]


@dataclass(frozen=True)
class Cell:
    """Hold one cell of a table: text, value, rank and tone."""

    text: str
    value: float | None = None  # sort key; None sorts by the text
    rank: int = 0  # 1, 2, 3; 0 = unmarked
    tone: Tone = ""
    note: str = ""  # shown as a tooltip


@dataclass(frozen=True)
class Heading:
    """Hold the heading of one column."""

    text: str
    numeric: bool = True
    note: str = ""

    @classmethod
    def of(cls, column: Column) -> Heading:
        """Return the heading of a metric's column."""
        return cls(column.title, note=column.meaning)


@dataclass(frozen=True)
class Table:
    """Hold rows of cells under headings."""

    name: str  # stem of its files
    title: str
    headings: Sequence[Heading]
    rows: Sequence[Sequence[Cell]]
    caption: str = ""
    groups: Sequence[tuple[str, int]] = ()  # a row above the headings: texts and the numbers of columns they span
    blocks: Sequence[int] = field(default=())  # first rows of blocks; equal first cells of a block are shown once

    @property
    def sortable(self) -> bool:
        """Return whether the page lets readers sort the rows; sorting would break blocks and grouped columns."""
        return not self.blocks and not self.groups and len(self.rows) > 1

    def shown(self, row: int, column: int) -> str:
        """Return the text of a cell; empty if a first cell repeats the one above within its block."""
        text = self.rows[row][column].text
        if column or not self.blocks or row in self.blocks or row == 0:
            return text
        return "" if self.rows[row - 1][0].text == text else text


def number(value: float | None, digits: int, missing: str = NONE) -> Cell:
    """Return a cell with a number."""
    return Cell(missing) if value is None else Cell(f"{value:,.{digits}f}", value)


def with_interval(estimate: Estimate | None, digits: int, *, signed: bool = False) -> Cell:
    """Return a cell such as ``3.21 [3.02, 3.40]``; without an interval, the number only."""
    if estimate is None:
        return Cell(MISSING)
    text = decimal(estimate.value, digits, signed=signed)
    if estimate.low is not None and estimate.high is not None:
        text += f" [{', '.join(decimal(end, digits, signed=signed) for end in (estimate.low, estimate.high))}]"
    return Cell(text, estimate.value)


def decimal(value: float, digits: int, *, signed: bool = False) -> str:
    """Format a number with a typographic minus; zero has no sign."""
    rounded = round(value, digits) or 0.0
    return f"{rounded:{'+' if signed and rounded else ''}.{digits}f}".replace("-", "−")


def ranked(cells: Sequence[Cell], column: Column, planners: Sequence[bool] | None = None) -> list[Cell]:
    """Return the cells with ranks 1 to 3; equal printed values share a rank, and a single value has none.

    ``planners`` marks the cells that are ranked; None ranks all. References are left out and do not affect ranks.
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
