"""Types of options that several commands share, with the names that help gives their values."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import tyro


def option(metavar: str, default: str | None = None) -> Any:
    """Settings of an option: the name help gives its value, and a text for the default."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=default)


Switch = Annotated[bool, tyro.conf.FlagCreatePairsOff]
Names = Annotated[tuple[str, ...], option("NAME [NAME ...]")]
NoNames = Annotated[tuple[str, ...], option("NAME [NAME ...]", "")]
Changes = Annotated[tuple[str, ...], option("FIELD=VALUE [FIELD=VALUE ...]", "")]
Words = tuple[str, ...] | None  # None where the option was not typed, which is not the same as its usual value
ViewSource = Literal["free_space", "recorded"]
Text = Annotated[str | None, option("TEXT", "")]
PathName = Annotated[str | None, option("PATH", "")]
Count = Annotated[int | None, option("N", "")]
# A name that is checked where it is used, whose error knows the nearest one.
PresetName = Annotated[str, option("fast|default|full|paper")]
Runs = Annotated[tuple[str, ...], tyro.conf.Positional, option("[RUN ...]", "")]
