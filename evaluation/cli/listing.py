"""Print what is registered by name: as a table for readers, as JSON for programs."""

from __future__ import annotations

import inspect
import json
import sys
from typing import Any

from rich.table import Table

from activestructure_gym.errors import printable
from activestructure_gym.evaluation.cli.output import make_console
from activestructure_gym.streams import fitting, say


def first_line(thing: Any) -> str:
    """First line of the docstring of a class or function."""
    return (inspect.getdoc(thing) or "").partition("\n")[0]


def print_listed(table: Table, hint: str) -> None:
    """Print a `list_table`, within the width of a terminal, and below it a hint."""
    console = make_console()
    console.print(table)
    console.print(hint)


def print_json(content: Any) -> int:
    """Print ``content`` as JSON; returns exit code 0."""
    text = json.dumps(content, indent=1, default=str, ensure_ascii=False)
    if fitting(printable(text), sys.stdout.encoding or "ascii") != text:  # JSON's own escapes keep it readable as JSON
        text = json.dumps(content, indent=1, default=str)
    say(text)
    return 0
