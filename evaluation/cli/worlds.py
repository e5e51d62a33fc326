"""Define ``asg list worlds``, which lists simulators, recordings and robots by name."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from typing import Annotated, Any

import tyro

from activestructure_gym.evaluation.cli.fields import Switch, option
from activestructure_gym.evaluation.cli.listing import first_line, print_json, print_listed, print_text
from activestructure_gym.evaluation.cli.options import split_list
from activestructure_gym.evaluation.cli.output import make_console

_HINT = (
    "asg list worlds NAME describes the options of a world. asg explore --world 'NAME?option=value' explores it. "
    "The name of your own world is package.module:factory."
)


@dataclass(frozen=True)
class Worlds:
    """List the worlds that `asg explore` takes by name, or describe some."""

    names: Annotated[tuple[str, ...], tyro.conf.Positional, option("[NAME ...]", "")] = ()
    """Describe these, with their options."""
    json: Switch = False
    """Print JSON."""

    def run(self) -> int:
        """Print a table of all worlds, or the whole descriptions of the named worlds."""
        from activestructure_gym.worlds import WORLDS

        names = split_list(self.names)
        facts = [_facts(name, WORLDS.get(name)) for name in names or WORLDS]
        if self.json:
            return print_json(facts)
        if names:
            print_text(make_console(), "\n\n".join(f"{one['name']}?{one['options']}\n\n{one['doc']}" for one in facts))
            return 0
        rows = [[one["name"], one["about"]] for one in facts]
        print_listed("Worlds", ["name", "description"], rows, _HINT, wide=False)
        return 0


def _facts(name: str, make: Any) -> dict[str, Any]:
    """Return name, first line, description and options of a world; ``make`` is the function that makes it."""
    parameters = inspect.signature(make).parameters.values()
    options = [one.name if one.default is one.empty else f"{one.name}={one.default}" for one in parameters]
    return {
        "name": name,
        "about": first_line(make),
        "doc": inspect.getdoc(make) or "It has no description.",
        "options": "&".join(options),
    }
