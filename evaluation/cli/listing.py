"""Print listings, such as the registered policies, as a table or as JSON, and print docstrings."""

from __future__ import annotations

import inspect
import json
import sys
from collections.abc import Sequence
from typing import Any

from rich.console import Console

from activestructure_gym.errors import printable
from activestructure_gym.evaluation.cli.output import make_console, print_lines, width_of
from activestructure_gym.evaluation.machine.terminal import aligned, paragraphs
from activestructure_gym.streams import escape, fitting, say


def first_line(thing: Any) -> str:
    """Return the first line of the docstring of a class or function."""
    return (inspect.getdoc(thing) or "").partition("\n")[0]


def print_listed(
    title: str,
    heads: Sequence[str],
    rows: Sequence[Sequence[str]],
    hint: str,
    *,
    wide: bool,
    most: Sequence[int] = (),
) -> None:
    """Print a title, the headings ``heads``, one line per row, and a hint below.

    The last entry of a row is shortened to the width of the terminal. With ``wide``, and in a log, nothing is
    shortened. ``most`` limits the widths of the other columns, see `aligned`.
    """
    console = make_console()
    console.print(title, style="bold", markup=False)
    entries = [[console.render_str(escape(entry)).plain for entry in row] for row in [heads, *rows]]
    ellipsis = "..." if console.options.ascii_only else "…"
    print_lines(console, aligned(entries, None if wide else width_of(console), most, ellipsis))
    console.print()
    console.print(hint, markup=False)


def print_text(console: Console, text: str) -> None:
    """Print a docstring: unchanged in a log, and with paragraphs wrapped at the width of a terminal."""
    if width_of(console) is None:
        print_lines(console, text.splitlines())
        return
    for paragraph in paragraphs(text):
        console.print(paragraph, markup=False)


def print_json(content: Any) -> int:
    """Print ``content`` as JSON; return exit code 0."""
    text = json.dumps(content, indent=1, default=str, ensure_ascii=False)
    if fitting(printable(text), sys.stdout.encoding or "ascii") != text:  # some characters need JSON escapes
        text = json.dumps(content, indent=1, default=str)
    say(text)
    return 0
