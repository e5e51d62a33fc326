"""The subcommands by name, and where the options of each stand; a module is loaded when its command is asked for."""

from __future__ import annotations

import typing
from importlib import import_module
from typing import Annotated, Protocol

from activestructure_gym.errors import unknown_name

COMMANDS = {
    "compare": "compare:Compare",
    "score": "score:Score",
    "policies": "policies:Policies",
    "scenes": "scenes:Scenes",
    "features": "features:Features",
    "config": "config:Config",
    "doctor": "doctor:Doctor",
    "bench": "bench:Bench",
    "train": "train:Train",
    "evaluate": "evaluate:Evaluate",
    "verify": "verify:Verify",
    "export": "export:Export",
    "report": "report:Report",
    "replay": "replay:Replay",
    "watch": "watch:Watch",
    "cache": "cache:Cache",
    "completion": "completion:Completion",
}


class Command(Protocol):
    """A subcommand: a dataclass of its options with a method that runs it."""

    def run(self) -> int:
        """Run the command; returns the exit code."""


def find_command(name: str) -> type[Command]:
    """The options of a subcommand; raises `InputError` for a name that is none."""
    if name not in COMMANDS:
        raise unknown_name("command", name, COMMANDS)
    module, _, kind = COMMANDS[name].partition(":")
    found: type[Command] = getattr(import_module(f"{__package__}.{module}"), kind)
    return found


def parts_of(kind: type) -> dict[str, type]:
    """The names and the options of what a command is split into, as train into bc, rank, ...; {} for most."""
    unions = [typing.get_args(hint) for hint in typing.get_type_hints(kind, include_extras=True).values()]
    annotated = [typing.get_args(part) for union in unions for part in union if typing.get_origin(part) is Annotated]
    return {note.name: options for options, *notes in annotated for note in notes if getattr(note, "name", None)}
