"""Define types of options that several commands share, with the metavariables that help prints for their values."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import tyro


def option(metavar: str, default: str | None = None, short: str | None = None) -> Any:
    """Return settings of an option: its metavariable in help, a text for its default, and a short form as ``-o``."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=default, aliases=None if short is None else (short,))


Switch = Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint="")]
Names = Annotated[tuple[str, ...], option("NAME [NAME ...]")]
NoNames = Annotated[tuple[str, ...], option("NAME [NAME ...]", "")]
Changes = Annotated[tuple[str, ...], option("FIELD=VALUE [FIELD=VALUE ...]", "")]
Words = tuple[str, ...] | None  # None: the option was not given, not even with its default
ViewSource = Literal["free_space", "recorded"]
Text = Annotated[str | None, option("TEXT", "")]
PathName = Annotated[str | None, option("PATH", "")]
Out = Annotated[str | None, option("PATH", "", "-o")]
DryRun = Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint="", aliases=("-n",))]
Count = Annotated[int | None, option("N", "")]
# No Literal: the error of the function that uses the name suggests the nearest one.
PresetName = Annotated[str, option("fast|default|full|paper")]
Runs = Annotated[tuple[str, ...], tyro.conf.Positional, option("[RUN ...]", "")]
