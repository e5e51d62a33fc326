"""Printing tables to a terminal of any width, and what is going on to a terminal or a log."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from rich import box
from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from activestructure_gym.errors import printable
from activestructure_gym.streams import Stream, escape, fitting, raw

_WIDEST = 400  # columns
_EVERY = 30.0  # seconds between two lines of the same kind in a log


class PlainConsole(Console):
    """A console that prints no control characters but its own, and of the others those that its stream can show."""

    def render_str(self, text: str, **options: Any) -> Text:  # type: ignore[override]
        """Return the string as text, before anything is measured or wrapped."""
        return super().render_str(self._shown(text), **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Yield the segments of what is printed."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(self._shown(segment.text), segment.style)

    def _shown(self, text: str) -> str:
        return fitting(printable(text), self.encoding)


def make_console() -> Console:
    """Return a console on standard output: as wide as the terminal or as ``COLUMNS`` says; a log is not wrapped."""
    stream = raw(getattr(sys.stdout, "rich_proxied_file", sys.stdout))
    stream = stream if isinstance(stream, Stream) else Stream(stream)
    endless = not stream.isatty() and not os.environ.get("COLUMNS")
    return _console(stream, _WIDEST if endless else None)


def _console(file: Any, width: int | None) -> Console:
    return PlainConsole(file=file, width=width, highlight=False, emoji=False)


@contextmanager
def working(console: Console, text: str) -> Iterator[Callable[[str], None]]:
    """A spinner beside ``text`` while the block runs, and a function that says something else there.

    A log, which shows no spinner, gets a line at the beginning, for every new kind of message (by its first word), and
    for one kind a line every half minute.
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


def print_whole(console: Console, table: Table) -> None:
    """Print the table in its full width, whatever the terminal's, so that no number is cut."""
    needed = console.measure(table, options=console.options.update(width=_WIDEST)).maximum
    if needed > console.width:
        # rich never exceeds a console's width, so the table gets a console of its own.
        console = _console(console.file, needed)
    console.print(table, crop=False)


def list_table(title: str, *columns: str) -> Table:
    """A table of words: but for the first column they are folded where a terminal is narrower."""
    table = plain_table(title)
    for place, column in enumerate(columns):
        table.add_column(column, no_wrap=not place, overflow="fold")
    return table


def plain_table(title: str, *columns: str) -> Table:
    """A table without a frame, with these columns."""
    table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
    for column in columns:
        table.add_column(column, no_wrap=True)
    return table
