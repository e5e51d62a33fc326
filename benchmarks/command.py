"""Run a benchmark from the command line."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import tyro
from rich.console import Console

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.output import progress_bar
from activestructure_gym.evaluation.machine import hardware as machine
from activestructure_gym.evaluation.machine.threads import set_passive_waiting
from activestructure_gym.streams import complain


class Command(Protocol):
    """Hold the options of a benchmark; a dataclass."""

    def run(self) -> int:
        """Measure and print; return the exit code."""
        ...


def run(kind: type[Command], words: Sequence[str] | None = None) -> int:
    """Run a benchmark with the program's arguments, or with ``words``; return the exit code, 2 for wrong input."""
    set_passive_waiting()
    try:
        return tyro.cli(kind, args=words).run()
    except InputError as error:
        complain(str(error))
        return 2


def write_rows(out: str, name: str, settings: Mapping[str, Any], rows: Sequence[Mapping[str, Any]]) -> Path:
    """Write rows with their settings and the hardware as JSON into the folder ``out``, which is returned."""
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    content = {"settings": settings, "hardware": machine.hardware(), "rows": rows}
    (folder / name).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return folder


@contextmanager
def measuring(console: Console, steps: int) -> Iterator[Callable[[], None]]:
    """Show a progress bar; yield the function that advances it by one step."""
    with progress_bar(console, disable=not console.is_terminal) as bar:
        task = bar.add_task("measuring", total=steps)
        yield lambda: bar.advance(task)
