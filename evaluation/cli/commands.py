"""List the commands by group and name, and print the help of ``asg``; import a command's module when it is run."""

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
        "watch": "watch:Watch",
        "train": "train:Train",
        "replay-trajectory": "replay_trajectory:ReplayTrajectory",
    },
    "Look": {
        "report": "report:Report",
        "replay": "replay:Replay",
    },
    "Check": {
        "evaluate": "evaluate:Evaluate",
        "verify": "verify:Verify",
    },
    "List": {
        "list": "lists:List",
    },
    "Files": {
        "export": "export:Export",
        "cache": "cache:Cache",
    },
    "System": {
        "doctor": "doctor:Doctor",
        "bench": "bench:Bench",
        "completion": "completion:Completion",
    },
}
# `asg policies` is `asg list policies`; help lists the second form only.
ALIASES = {
    "policies": "policies:Policies",
    "scenes": "scenes:Scenes",
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
    """Define a subcommand: a dataclass of its options with a method that runs it."""

    def run(self) -> int:
        """Run the command and return the exit code."""


def find_command(name: str) -> type[Command]:
    """Return the class of a command; raise `InputError` for an unknown name."""
    if name not in COMMANDS:
        raise unknown_name("command", name, COMMANDS)
    module, _, kind = COMMANDS[name].partition(":")
    found: type[Command] = getattr(import_module(f"{__package__}.{module}"), kind)
    return found


def parts_of(kind: type) -> dict[str, type]:
    """Return the classes of a command's parts by name, as bc and rank of train; {} for a command without parts."""
    unions = [typing.get_args(hint) for hint in typing.get_type_hints(kind, include_extras=True).values()]
    annotated = [typing.get_args(part) for union in unions for part in union if typing.get_origin(part) is Annotated]
    return {note.name: options for options, *notes in annotated for note in notes if getattr(note, "name", None)}


def help_text() -> str:
    """Return the help of ``asg``, with every group and its commands."""
    size = max(map(len, SHOWN))
    lines = list[str]()
    for group, commands in GROUPS.items():
        lines += ["", group, *(f"  {name:{size}}  {summary(name)}" for name in commands)]
    return _HELP.format(groups="\n".join([*lines, ""]))


def summary(name: str) -> str:
    """Return the first line of a command's docstring, read from its source: importing all commands takes too long."""
    module, _, kind = COMMANDS[name].partition(":")
    spec = find_spec(f"{__package__}.{module}")
    assert spec is not None and spec.origin is not None
    tree = ast.parse(Path(spec.origin).read_text(encoding="utf-8"))
    (node,) = (node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == kind)
    return (ast.get_docstring(node) or "").partition("\n")[0].rstrip(".")
