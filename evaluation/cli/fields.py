"""Kinds of options that several commands have, with what help calls their values."""

from __future__ import annotations

from typing import Annotated, Any

import tyro


def option(metavar: str, default: str | None = None) -> Any:
    """What help calls a value, and what it says of the default where the value itself says nothing."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=default)


Switch = Annotated[bool, tyro.conf.FlagCreatePairsOff]
Names = Annotated[tuple[str, ...], option("NAME [NAME ...]")]
NoNames = Annotated[tuple[str, ...], option("NAME [NAME ...]", "")]
Changes = Annotated[tuple[str, ...], option("FIELD=VALUE [FIELD=VALUE ...]", "")]
Text = Annotated[str | None, option("TEXT", "")]
PathName = Annotated[str | None, option("PATH", "")]
Count = Annotated[int | None, option("N", "")]
Preset = Annotated[str, option("fast|default|paper")]
Runs = Annotated[tuple[str, ...], tyro.conf.Positional, option("[RUN ...]", "")]
