"""The command ``asg``: compare policies, look at scenes, see what works here."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.evaluation.machine.threads import set_passive_waiting

# Written out, and not left to the parser, so that it appears at once.
HELP = """usage: asg COMMAND [OPTIONS]

ActiveStructure Gym: planners for active 3D reconstruction, compared.

  asg compare    run policies on scenes under one budget; ends with a table, curves and pictures
  asg policies   list the policies known by name, or describe one
  asg scenes     list the scenes known by name, or check one
  asg features   list the gains of a candidate view that a policy can ask for
  asg config     print the configuration of an episode, and what a preset or --set changes
  asg doctor     say what works here, what does not, and which package is missing
  asg bench      measure the speed of the sensor, the rasteriser, the evaluation
  asg train      train a learned policy (bc, rank, ppo), or score policies on layouts nobody was trained on
  asg evaluate   measure finished runs again, from their stored maps alone, or anybody's map
  asg export     write a run's map as 3D Gaussian splatting PLY, .splat or SplaTAM's params.npz
  asg report     write the report of finished runs: one page, and tables for papers
  asg cache      show what is kept on disk between runs, or remove it
  asg completion print a script that lets bash, zsh or fish complete all of this

  asg COMMAND --help    the options of a command
  asg --version

Begin with `asg compare`: two planners in a furnished room, in less than a minute, with nothing to download."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code: 0 done, 1 some of it failed, 2 wrong input, 130 stopped with Ctrl-C."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments or arguments[0] in ("-h", "--help") or arguments == ["help"]:
        print(HELP)
        return 0
    if arguments[0] == "--version":
        from activestructure_gym._version import __version__

        print(f"activestructure-gym {__version__}")
        return 0
    set_passive_waiting()
    try:
        _find_in_working_directory()
        with _doubts_as_lines():
            return _run(arguments)
    except InputError as error:
        print(f"asg: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("asg: stopped", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # The reader (`| head`) has gone; nothing more can be said to it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _find_in_working_directory() -> None:
    """Let ``my_policy:MyPolicy`` be found there, but nothing in the place of an installed package."""
    try:
        here = os.getcwd()
    except FileNotFoundError:  # deleted meanwhile
        raise InputError("the working directory does not exist any more; change into another one") from None
    if here not in sys.path and "" not in sys.path:
        sys.path.append(here)


@contextmanager
def _doubts_as_lines() -> Iterator[None]:
    """What is doubtful about the user's files, each once and as one line; Python would show where it was said."""
    told: set[str] = set()

    def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        if not issubclass(category, InputWarning):
            usual(message, category, *place, **more)
        elif str(message) not in told:
            told.add(str(message))
            print(f"asg: note: {message}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("always", InputWarning)
        usual, warnings.showwarning = warnings.showwarning, show
        yield


def _run(arguments: Sequence[str]) -> int:
    from activestructure_gym.evaluation.cli.commands import find_command

    name, *rest = arguments
    if name == "help":
        name, rest = rest[0], [*rest[1:], "--help"]
    kind = find_command(name)

    from activestructure_gym.evaluation.cli.parsing import parse

    try:
        command = parse(kind, name, rest)
    except SystemExit:  # after help
        return 0
    return command.run()
