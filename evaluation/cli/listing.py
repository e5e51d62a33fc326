"""How what there is by name is listed: as a table for readers, as JSON for programs."""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterable
from typing import Any

from rich.table import Table

from activestructure_gym.evaluation.cli.output import make_console, print_whole


def first_line(thing: Any) -> str:
    """Of a function or class, also of one with some of its arguments given."""
    return (inspect.getdoc(getattr(thing, "func", thing)) or "").partition("\n")[0]


def grouped(names: Iterable[str]) -> list[str]:
    """Names, those that differ in nothing but a number and an axis as one: ``look_0_x .. look_9_z``."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(re.sub(r"(_\d+)?_[xyz]$", " by axis", name), []).append(name)
    return [members[0] if len(members) == 1 else f"{members[0]} .. {members[-1]}" for members in groups.values()]


def print_listed(table: Table, hint: str) -> None:
    """The table, and below it what can be done with it."""
    console = make_console()
    print_whole(console, table)
    console.print(hint)


def print_json(content: Any) -> int:
    """For programs; returns the exit code."""
    print(json.dumps(content, indent=1, default=str, ensure_ascii=False))
    return 0
