"""Define the types of options that several commands share; a type has the placeholder that help prints for a value."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import tyro


def option(metavar: str, default: str | None = None, short: str | None = None) -> Any:
    """Return tyro's settings of an option.

    ``metavar`` is the placeholder of its value in help, such as "SCENE". ``default`` is the text in help about its
    default; None lets tyro write it. ``short`` is a short form, such as ``-o``.
    """
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=default, aliases=None if short is None else (short,))


Switch = Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint="")]
Names = Annotated[tuple[str, ...], option("NAME [NAME ...]")]
NoNames = Annotated[tuple[str, ...], option("NAME [NAME ...]", "")]
Changes = Annotated[tuple[str, ...], option("FIELD=VALUE [FIELD=VALUE ...]", "")]
Words = tuple[str, ...] | None  # None: the option is not given; this differs from giving its default explicitly
ViewSource = Literal["free_space", "recorded"]
Text = Annotated[str | None, option("TEXT", "")]
PathName = Annotated[str | None, option("PATH", "")]
Out = Annotated[str | None, option("PATH", "", "-o")]
DryRun = Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint="", aliases=("-n",))]
Count = Annotated[int | None, option("N", "")]
# A text and no Literal, so the error comes from `known_preset`, which suggests the most similar name.
PresetName = Annotated[str, option("rl|fast|default|full|paper")]
Runs = Annotated[tuple[str, ...], tyro.conf.Positional, option("[RUN ...]", "")]
