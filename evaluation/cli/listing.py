"""Print what is registered by name: as a table for readers, as JSON for programs."""

from __future__ import annotations

import inspect
import json
from typing import Any

from rich.table import Table

from activestructure_gym.evaluation.cli.output import make_console


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
    print(json.dumps(content, indent=1, default=str, ensure_ascii=False))
    return 0
