"""Rows of any names as a table, and the options that benchmarks share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from rich.console import Console
from rich.table import Table

from activestructure_gym.evaluation.cli.fields import option
from activestructure_gym.evaluation.cli.options import split_list
from activestructure_gym.evaluation.cli.output import plain_table, print_whole
from activestructure_gym.streams import escape

SceneNames = Annotated[str | None, option("SCENE,...", "")]


def split_names(scenes: str | None) -> tuple[str, ...]:
    """Scenes separated by commas; () where none is given."""
    return split_list([scenes] if scenes else [])


def print_rows(console: Console, rows: Sequence[Mapping[str, Any]], title: str) -> None:
    """Print one table."""
    print_whole(console, rows_table(rows, title=title))


def rows_table(rows: Sequence[Mapping[str, Any]], *, title: str) -> Table:
    """Rows of any names as a table; numbers to three digits."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    table = plain_table(title)
    for name in names:
        numeric = all(isinstance(row.get(name), int | float | type(None)) for row in rows)
        table.add_column(name.replace("_", " "), justify="right" if numeric else "left")
    for row in rows:
        table.add_row(*(escape(_text(row.get(name))) for name in names))
    return table


def _text(value: Any) -> str:
    if value is None or value != value:  # NaN is not equal to itself
        return "n/a"
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_text(entry)}" for key, entry in value.items())
    if isinstance(value, tuple | list):
        return " .. ".join(_text(entry) for entry in value)
    return str(value)
