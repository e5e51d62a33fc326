"""Printing tables to a terminal of any width."""

from __future__ import annotations

from rich import box
from rich.console import Console
from rich.table import Table

_WIDEST = 400  # columns


def print_whole(console: Console, table: Table) -> None:
    """Print the table in its full width, whatever the terminal's: a terminal can be widened, a cut number is lost."""
    needed = console.measure(table, options=console.options.update(width=_WIDEST)).maximum
    if needed > console.width:
        # rich never exceeds a console's width, so the table gets a console of its own.
        console = Console(file=console.file, width=needed, highlight=False)
    console.print(table, crop=False)


def plain_table(title: str, *columns: str) -> Table:
    """A table without a frame, in the look of all of ours."""
    table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
    for column in columns:
        table.add_column(column, no_wrap=True)
    return table
