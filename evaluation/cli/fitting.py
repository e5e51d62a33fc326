"""Format tables as lines of text that fit the width of a terminal; wide tables are split into parts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from rich.cells import cell_len
from rich.table import Table
from rich.text import Text

from activestructure_gym.evaluation.machine.terminal import GAP, breaks, longest_piece

_MIN_COLUMNS = 8  # characters; least width to which the leading text columns of a split table are folded
_PIECE = 24  # characters; longer words may be broken at any character


@dataclass(frozen=True)
class _Column:
    """Hold the heading and the cells of a column, and compute its widths in characters."""

    head: Text
    cells: list[Text]
    numeric: bool  # whether the cells are numbers, which are aligned to the right

    @property
    def natural(self) -> int:
        """Return the width without folding; the heading of a numeric column has its unit in a second line."""
        head = _first_lines(self.head.plain) if self.numeric else [self.head.plain]
        return max(map(cell_len, [*head, *(cell.plain for cell in self.cells)]), default=0)

    @property
    def least(self) -> int:
        """Return the least width to which the column can be folded; numbers are not folded."""
        words = [self.head.plain] if self.numeric else [self.head.plain, *(cell.plain for cell in self.cells)]
        least = min(max(map(longest_piece, words), default=0), _PIECE)
        return max([least, *(cell_len(cell.plain) for cell in self.cells)]) if self.numeric else least


def table_lines(
    table: Table, width: int | None, *, rule: str = "─", shown: Callable[[str], Text] = Text.from_markup
) -> Iterator[Text]:
    """Yield the lines of a table, each at most ``width`` characters wide (None: no limit).

    Texts are folded. If the columns do not fit, the table is split into parts below each other, and every part begins
    with the leading text columns. ``rule`` is the character of the line below the headings, and ``shown`` converts the
    markup of a cell to styled text.
    """
    columns = _columns(table, shown)
    if not columns:
        return
    ends = [row.end_section for row in table.rows]
    styles = [row.style or "" for row in table.rows]
    for number, part in enumerate(_parts(columns, width)):
        chosen = [(columns[k], size) for k, size in part.items()]
        if number:
            yield Text()
        if any(column.head.plain for column, _ in chosen):
            heads = [[Text(line, "bold") for line in _head_lines(column, size)] for column, size in chosen]
            yield from _drawn(heads, chosen, bottom=True)
            yield Text(rule * (sum(part.values()) + GAP * (len(part) - 1)), "dim")
        for row, (ends_section, style) in enumerate(zip(ends, styles)):
            for line in _drawn([_folded(column.cells[row], size) for column, size in chosen], chosen):
                line.style = style
                yield line
            if ends_section and row + 1 < len(ends):
                yield Text()


def fits(table: Table, width: int) -> bool:
    """Return whether a table fits into ``width`` characters without folding."""
    columns = _columns(table)
    return sum(column.natural for column in columns) + GAP * (len(columns) - 1) <= width


def _columns(table: Table, shown: Callable[[str], Text] = Text.from_markup) -> list[_Column]:
    return [
        _Column(shown(str(column.header)), [shown(str(cell)) for cell in column.cells], column.justify == "right")
        for column in table.columns
    ]


def _parts(columns: Sequence[_Column], width: int | None) -> list[dict[int, int]]:
    """Split a table into parts that fit ``width``; a part is a dictionary from column index to width in characters.

    Every part begins with the leading text columns. None as ``width`` gives one part.
    """
    natural, least = [column.natural for column in columns], [column.least for column in columns]
    if width is None or sum(natural) + GAP * (len(columns) - 1) <= width:
        return [dict(enumerate(natural))]
    words = next((k for k, column in enumerate(columns) if column.numeric), len(columns))
    keys = range(max(1, words) if words < len(columns) else 1)
    room = max(_MIN_COLUMNS, width // 2 // len(keys) - GAP)
    start = {k: min(least[k], room) for k in keys}
    parts, part = [], dict(start)
    for k in range(len(keys), len(columns)):
        needed = sum(part.values()) + GAP * len(part)
        if needed + least[k] > width and len(part) > len(start):
            parts.append(part)
            part = dict(start)
            needed = sum(part.values()) + GAP * len(part)
        part[k] = min(least[k], max(width - needed, 1))
    return [_widened(part, natural, width) for part in [*parts, part]]


def _widened(part: dict[int, int], natural: Sequence[int], width: int) -> dict[int, int]:
    """Widen the columns of a part from left to right until ``width`` is used, each at most to its ``natural`` width."""
    part = dict(part)
    left = width - sum(part.values()) - GAP * (len(part) - 1)
    for k in part:
        more = max(0, min(natural[k] - part[k], left))
        part[k] += more
        left -= more
    return part


def _drawn(cells: list[list[Text]], chosen: list[tuple[_Column, int]], *, bottom: bool = False) -> Iterator[Text]:
    """Yield the lines of a table row, given the lines of each of its cells and the width of each column.

    Cells with fewer lines are aligned at the top, or at the bottom if ``bottom``.
    """
    height = max(map(len, cells))
    for k in range(height):
        line = Text()
        for lines, (column, size) in zip(cells, chosen):
            at = k - (height - len(lines)) if bottom else k
            cell = lines[at] if 0 <= at < len(lines) else Text()
            blank = " " * (size - cell_len(cell.plain))
            line.append_text(Text(blank) + cell if column.numeric else cell + Text(blank))
            line.append(" " * GAP)
        line.rstrip()
        yield line


def _head_lines(column: _Column, size: int) -> list[str]:
    lines = _first_lines(column.head.plain) if column.numeric else [column.head.plain]
    return [part.plain for line in lines for part in _folded(Text(line), size)]


def _first_lines(head: str) -> list[str]:
    """Split the heading of a numeric column into lines: the name, and the unit in parentheses."""
    return head.replace(" (", "\n(").split("\n")


def _folded(cell: Text, size: int) -> list[Text]:
    lines = []
    for paragraph in cell.split("\n", allow_blank=True):
        for line in paragraph.divide(breaks(paragraph.plain, max(size, 1))[1:]):
            line.rstrip()
            lines.append(line)
    return lines
