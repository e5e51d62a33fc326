"""Tables as data: headings, cells, ranks. `formats` and `html` write them out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from activestructure_gym.evaluation.report.tables.columns import Column
from activestructure_gym.evaluation.statistics import Estimate

NONE = "n/a"  # a number that is not defined
MISSING = "–"  # no run: as in the paper, "failure to complete"

Judgement = Literal["", "good", "bad"]
Tone = Literal[Judgement, "alarm"]


@dataclass(frozen=True)
class Cell:
    """One cell of a table: its text, the value behind it, and its mark."""

    text: str
    value: float | None = None  # what it is sorted by; None: by its text, or it has none
    rank: int = 0  # 1, 2, 3; 0 = unmarked
    tone: Tone = ""
    note: str = ""  # shown on demand, where there is a hand to ask


@dataclass(frozen=True)
class Heading:
    """Heading of one column."""

    text: str
    numeric: bool = True
    note: str = ""

    @classmethod
    def of(cls, column: Column) -> Heading:
        """The heading of a metric's column."""
        return cls(column.title)


@dataclass(frozen=True)
class Table:
    """Rows of cells under headings."""

    name: str  # of its files
    title: str
    headings: Sequence[Heading]
    rows: Sequence[Sequence[Cell]]
    caption: str = ""
    groups: Sequence[tuple[str, int]] = ()  # a row above the headings: text, columns it spans
    blocks: Sequence[int] = field(default=())  # rows that begin a block; a first cell that repeats is said once in it

    @property
    def sortable(self) -> bool:
        """Whether readers may sort the rows: not where blocks or grouped columns would be torn apart."""
        return not self.blocks and not self.groups and len(self.rows) > 1

    def shown(self, row: int, column: int) -> str:
        """The text of a cell, empty where the first column repeats itself within a block."""
        text = self.rows[row][column].text
        if column or not self.blocks or row in self.blocks or row == 0:
            return text
        return "" if self.rows[row - 1][0].text == text else text


def number(value: float | None, digits: int, missing: str = NONE) -> Cell:
    """A cell with a plain number."""
    return Cell(missing) if value is None else Cell(f"{value:,.{digits}f}", value)


def with_interval(estimate: Estimate | None, digits: int, *, signed: bool = False) -> Cell:
    """A cell such as ``3.21 [3.02, 3.40]``; without an interval the number alone."""
    if estimate is None:
        return Cell(MISSING)
    text = decimal(estimate.value, digits, signed=signed)
    if estimate.low is not None and estimate.high is not None:
        text += f" [{', '.join(decimal(end, digits, signed=signed) for end in (estimate.low, estimate.high))}]"
    return Cell(text, estimate.value)


def decimal(value: float, digits: int, *, signed: bool = False) -> str:
    """A number as printed: no zero has a sign, and the minus is a minus."""
    rounded = round(value, digits) or 0.0
    return f"{rounded:{'+' if signed and rounded else ''}.{digits}f}".replace("-", "−")


def ranked(cells: Sequence[Cell], column: Column, planners: Sequence[bool] | None = None) -> list[Cell]:
    """The cells with ranks 1 to 3; cells equal as printed share a rank, and a single value has none.

    ``planners`` tells cell by cell who takes part (None: all): references have no rank and take none from others.
    """
    part = [True] * len(cells) if planners is None else planners
    values = {
        i: round(cell.value, column.digits)
        for i, (cell, takes_part) in enumerate(zip(cells, part, strict=True))
        if takes_part and cell.value is not None
    }
    if column.best is None or len(values) < 2:
        return list(cells)
    order = sorted(values.values(), reverse=column.best == "highest")
    return [
        replace(cell, rank=rank) if i in values and (rank := order.index(values[i]) + 1) <= 3 else cell
        for i, cell in enumerate(cells)
    ]
