"""Print tables to a terminal of any width, and progress to a terminal or a log."""

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

_MAX_COLUMNS = 10_000  # columns
_WIDE = 110  # columns; from this width on, progress bars are long
_EVERY = 30.0  # seconds between two lines of the same kind in a log


class PlainConsole(Console):
    """Print to a stream without control characters of the text, and without characters that its encoding lacks."""

    def render_str(self, text: str, **options: Any) -> Text:  # type: ignore[override]
        """Return the string as text, cleaned before it is measured or wrapped."""
        return super().render_str(self._shown(text), **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Yield the segments of what is printed."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(self._shown(segment.text), segment.style)

    def _shown(self, text: str) -> str:
        return fitting(printable(text), self.encoding)


def make_console() -> Console:
    """Return a console on standard output, as wide as the terminal or ``COLUMNS``; a log is not wrapped."""
    stream = raw(getattr(sys.stdout, "rich_proxied_file", sys.stdout))
    stream = stream if isinstance(stream, Stream) else Stream(stream)
    endless = not stream.isatty() and not os.environ.get("COLUMNS")
    return _console(stream, _MAX_COLUMNS if endless else None)


def _console(file: Any, width: int | None) -> Console:
    return PlainConsole(file=file, width=width, highlight=False, emoji=False)


@contextmanager
def working(console: Console, text: str) -> Iterator[Callable[[str], None]]:
    """Show a spinner next to ``text`` while the block runs; yield a function that replaces the text.

    A log gets lines instead: one at the beginning, one for every new kind of message (its first word), and at most one
    line of each kind in 30 s.
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
    """Return a progress bar: description, bar, the columns ``behind`` and the time left; see `short_title`."""
    size = 32 if console.width >= _WIDE else 8
    left = TimeRemainingColumn(table_column=Column(no_wrap=True))
    columns = TextColumn("{task.description}"), BarColumn(bar_width=size), *behind, left
    return Progress(*columns, console=console, transient=True, **options)


def short_title(console: Console, title: str) -> str:
    """Return the description of a bar, shortened to half of the terminal and escaped."""
    return escape(shortened(title, console.width // 2, "..." if console.options.ascii_only else "…"))


def width_of(console: Console) -> int | None:
    """Return the width of the terminal in columns, or None for a log."""
    return None if console.width >= _MAX_COLUMNS else console.width


def print_whole(console: Console, table: Table, *, wide: bool = False) -> None:
    """Print a table in parts that fit the terminal, so that no number is cut; with ``wide`` in one part."""
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
    """Return an empty table with these columns."""
    table = Table(title=title)
    for column in columns:
        table.add_column(column)
    return table
