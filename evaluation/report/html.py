"""Render the Jinja2 templates of the report page; every text that is not markup is escaped."""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from jinja2.ext import Extension
from markupsafe import Markup

from activestructure_gym.errors import pluralised
from activestructure_gym.evaluation.report.style import hue
from activestructure_gym.evaluation.report.tables.formats import latex
from activestructure_gym.evaluation.report.tables.layout import Cell, Table
from activestructure_gym.evaluation.report.text_filters import compressed, without_folders

_TEMPLATES = Path(__file__).with_name("templates")
# A line break before or after a tag, with the blanks around it.
_BREAK_AT_TAG = re.compile(r"(?:(?<=>)|(?<=%\})|(?<=#\}))\s*\n\s*|\s*\n\s*(?=<|\{%|\{#)")
_BREAK = re.compile(r"\s*\n\s*")


class _LinesJoined(Extension):
    """Remove line breaks next to tags in templates, and replace line breaks within text by spaces.

    This makes pages with many runs smaller.
    """

    def preprocess(self, source: str, name: str | None, filename: str | None = None) -> str:
        """Return the source of a template with its lines joined; Jinja2 calls this before it parses a template."""
        return _BREAK.sub(" ", _BREAK_AT_TAG.sub("", source.strip()))


@functools.cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES), autoescape=True, undefined=StrictUndefined, extensions=[_LinesJoined]
    )
    environment.filters |= {
        "pluralised": pluralised,
        "hue": hue,
        "compressed": compressed,
        "place": "{:.1f}".format,
        "with_its_arrow": lambda text: text.replace(" ↓", "\u00a0↓").replace(" ↑", "\u00a0↑"),  # no break before it
        "without_folders": without_folders,
    }
    return environment


def render(template: str, **content: Any) -> Markup:
    """Return the file ``template`` of ``templates/``, filled with ``content``."""
    return Markup(_environment().get_template(template).render(content))


class _Shown(NamedTuple):
    """Hold a table cell in the form that the template needs."""

    tag: str  # th or td
    attributes: dict[str, Any]
    text: str
    spread: str  # interval or deviation after the number, in a smaller font
    dot: int | None  # index of the policy named in the cell, for a dot in its colour


def html_table(table: Table, *, colours: Sequence[str] = (), exact: bool = True) -> Markup:
    """Return a table with its caption as HTML.

    Policies in ``colours`` get a dot in their colour. Readers can sort the rows: by the values in full precision if
    ``exact``, else by the printed values. With ``exact``, they can copy the table as LaTeX.
    """
    ends = [0, *table.blocks, len(table.rows)]
    blocks = [
        [_row(table, index, end, colours, exact) for index in range(start, end)]
        for start, end in zip(ends[:-1], ends[1:])
    ]
    return render("table.html.j2", table=table, blocks=blocks, latex=compressed([latex(table)]) if exact else "")


def _row(table: Table, index: int, end: int, colours: Sequence[str], exact: bool) -> list[_Shown]:
    """Return the cells of row ``index``, whose block ends before row ``end``.

    The first cell is left out if it repeats the cell above; instead, the cell above spans several rows.
    """
    cells = []
    for column, cell in enumerate(table.rows[index]):
        rows_below = 1
        if column == 0 and table.blocks:
            if table.shown(index, 0) == "":
                continue
            rows_below = sum(row[0].text == cell.text for row in table.rows[index:end])
        cells.append(_shown(cell, column, table, rows_below, colours, exact))
    return cells


def _shown(cell: Cell, column: int, table: Table, rows: int, colours: Sequence[str], exact: bool) -> _Shown:
    numeric, name = table.headings[column].numeric, cell.note or cell.text
    kinds = ("n" if numeric else "", f"r{cell.rank}" if cell.rank else "", cell.tone)
    text, spread = _split_spread(cell.text) if numeric else (cell.text, "")
    attributes = {
        "class": " ".join(filter(None, kinds)) or None,
        "title": {1: "1st", 2: "2nd", 3: "3rd"}.get(cell.rank, cell.note if cell.note != cell.text else "") or None,
        "scope": "row" if column == 0 else None,
        "rowspan": rows if rows > 1 else None,
        "data-value": repr(cell.value) if exact and cell.value is not None else None,
    }
    dot = colours.index(name) if not numeric and name in colours else None
    return _Shown("th" if column == 0 else "td", attributes, text, spread, dot)


def _split_spread(text: str) -> tuple[str, str]:
    """Split a text such as "3.2 [3.0, 3.4]" or "3.2 ± 0.1" after the number; the second part may be empty."""
    for mark in (" [", " ± "):
        number, found, rest = text.partition(mark)
        if found:
            return number, mark + rest
    return text, ""
