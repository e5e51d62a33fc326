"""Print tables and progress to a terminal of any width, or to a log: an output that is not a terminal."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import BarColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn
from rich.segment import Segment
from rich.table import Column, Table
from rich.text import Text

from activestructure_gym.errors import printable
from activestructure_gym.evaluation.cli.fitting import table_lines
from activestructure_gym.evaluation.machine.terminal import shortened
from activestructure_gym.streams import Stream, escape, fitting, raw

_MAX_COLUMNS = 10_000  # width in characters that is given to rich for a log, whose lines are not wrapped
_WIDE = 110  # characters; in a terminal of at least this width, progress bars are long
_EVERY = 30.0  # least number of seconds between two lines of the same kind in a log


class PlainConsole(Console):
    """Print to a stream, but replace control characters in texts and characters that the stream's encoding lacks."""

    def render_str(self, text: str, **options: Any) -> Text:  # type: ignore[override]
        """Convert markup to styled text; characters are replaced before the text is measured and wrapped."""
        return super().render_str(self._shown(text), **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Yield the segments of anything that rich can print, with characters replaced."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(self._shown(segment.text), segment.style)

    def _shown(self, text: str) -> str:
        return fitting(printable(text), self.encoding)


def make_console() -> Console:
    """Return a console for standard output, as wide as the terminal or ``COLUMNS``; lines of a log are not wrapped."""
    stream = raw(getattr(sys.stdout, "rich_proxied_file", sys.stdout))
    stream = stream if isinstance(stream, Stream) else Stream(stream)
    endless = not stream.isatty() and not os.environ.get("COLUMNS")
    return _console(stream, _MAX_COLUMNS if endless else None)


def _console(file: Any, width: int | None) -> Console:
    return PlainConsole(file=file, width=width, highlight=False, emoji=False)


@contextmanager
def working(console: Console, text: str) -> Iterator[Callable[[str], None]]:
    """Show a spinner next to ``text`` during the ``with`` block; yield a function that replaces the text.

    In a log, lines are printed instead. Messages with the same first word are of one kind, and at most one message of
    each kind is printed in 30 s.
    """
    last = dict[str, float]()
    if not console.is_terminal:
        console.print(escape(text), style="dim")
    with console.status(escape(text)) as spinner:

        def say(text: str) -> None:
            spinner.update(escape(text))
            kind, now = text.partition(" ")[0], time.monotonic()
            if not console.is_terminal and now - last.get(kind, -_EVERY) >= _EVERY:
                last[kind] = now
                console.print(escape(text), style="dim")

        yield say


def progress_bar(console: Console, *behind: ProgressColumn, **options: Any) -> Progress:
    """Return a progress bar with a description, the bar, the columns ``behind``, and the remaining time.

    `short_title` shortens a description. ``options`` are passed to rich's `Progress`.
    """
    size = 32 if console.width >= _WIDE else 8
    left = TimeRemainingColumn(table_column=Column(no_wrap=True))
    columns = TextColumn("{task.description}"), BarColumn(bar_width=size), *behind, left
    return Progress(*columns, console=console, transient=True, **options)


def short_title(console: Console, title: str) -> str:
    """Return a title for a progress bar: shortened to half of the terminal's width, and with markup escaped."""
    return escape(shortened(title, console.width // 2, "..." if console.options.ascii_only else "…"))


def width_of(console: Console) -> int | None:
    """Return the width of the terminal in characters, or None for a log."""
    return None if console.width >= _MAX_COLUMNS else console.width


def print_whole(console: Console, table: Table, *, wide: bool = False) -> None:
    """Print a table in parts that fit the terminal, without cutting numbers; with ``wide``, print it in one part."""
    if table.title:
        console.print(str(table.title), style="bold")
    rule = "-" if console.options.ascii_only else "─"
    for line in table_lines(table, None if wide else width_of(console), rule=rule, shown=console.render_str):
        console.print(line, soft_wrap=True)
    console.print()


def print_lines(console: Console, lines: Iterable[str]) -> None:
    """Print lines without wrapping."""
    for line in lines:
        console.print(Text(line), soft_wrap=True)


def plain_table(title: str, *columns: str) -> Table:
    """Return an empty table with a title and the given column headings."""
    table = Table(title=title)
    for column in columns:
        table.add_column(column)
    return table
