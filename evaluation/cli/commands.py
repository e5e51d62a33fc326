"""List the commands of ``asg`` by group and name, and print their overview.

The module of a command is imported only when the command runs, since the imports are slow.
"""

from __future__ import annotations

import ast
import typing
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Protocol

from activestructure_gym.errors import unknown_name

GROUPS = {
    "Run": {
        "compare": "compare:Compare",
        "explore": "explore:Explore",
        "watch": "watch:Watch",
        "train": "train:Train",
        "replay-trajectory": "replay_trajectory:ReplayTrajectory",
    },
    "Look": {
        "report": "report:Report",
        "replay": "replay:Replay",
        "why": "why:Why",
    },
    "Check": {
        "evaluate": "evaluate:Evaluate",
        "verify": "verify:Verify",
    },
    "List": {
        "list": "lists:List",
    },
    "Files": {
        "new": "new:New",
        "export": "export:Export",
        "cache": "cache:Cache",
    },
    "System": {
        "doctor": "doctor:Doctor",
        "bench": "bench:Bench",
        "completion": "completion:Completion",
    },
}
# `asg policies` is short for `asg list policies`; help shows only the long form.
ALIASES = {
    "policies": "policies:Policies",
    "scenes": "scenes:Scenes",
    "worlds": "worlds:Worlds",
    "features": "features:Features",
    "config": "config:Config",
}
SHOWN = {name: place for commands in GROUPS.values() for name, place in commands.items()}
COMMANDS = SHOWN | ALIASES

_HELP = """usage: asg COMMAND [OPTIONS]

ActiveStructure Gym: planners for active 3D reconstruction, compared.
{groups}
asg COMMAND --help prints the options of a command, asg --version the version.

Begin with `asg compare`: random against activestructure in a furnished room,
in about a minute, with nothing to download."""


class Command(Protocol):
    """Define the interface of a command: a dataclass of its options, with a method that runs it."""

    def run(self) -> int:
        """Run the command and return the exit code."""


def find_command(name: str) -> type[Command]:
    """Import and return the class of the command ``name``; raise `InputError` for an unknown name."""
    if name not in COMMANDS:
        raise unknown_name("command", name, COMMANDS)
    module, _, kind = COMMANDS[name].partition(":")
    found: type[Command] = getattr(import_module(f"{__package__}.{module}"), kind)
    return found


def parts_of(kind: type) -> dict[str, type]:
    """Return the classes of a command's subcommands by name, such as bc and rank of train; {} if it has none."""
    unions = [typing.get_args(hint) for hint in typing.get_type_hints(kind, include_extras=True).values()]
    annotated = [typing.get_args(part) for union in unions for part in union if typing.get_origin(part) is Annotated]
    return {note.name: options for options, *notes in annotated for note in notes if getattr(note, "name", None)}


def help_text() -> str:
    """Return the help of ``asg`` as text: every group with its commands."""
    size = max(map(len, SHOWN))
    lines = list[str]()
    for group, commands in GROUPS.items():
        lines += ["", group, *(f"  {name:{size}}  {summary(name)}" for name in commands)]
    return _HELP.format(groups="\n".join([*lines, ""]))


def summary(name: str) -> str:
    """Return the first line of a command's docstring, without the final full stop.

    It is read from the source file, since importing all commands takes too long.
    """
    module, _, kind = COMMANDS[name].partition(":")
    spec = find_spec(f"{__package__}.{module}")
    assert spec is not None and spec.origin is not None
    tree = ast.parse(Path(spec.origin).read_text(encoding="utf-8"))
    (node,) = (node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == kind)
    return (ast.get_docstring(node) or "").partition("\n")[0].rstrip(".")
