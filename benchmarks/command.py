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
    """Define the interface of a benchmark: a dataclass of its options, with a method that runs it."""

    def run(self) -> int:
        """Measure, print the results, and return the exit code."""
        ...


def run(kind: type[Command], words: Sequence[str] | None = None) -> int:
    """Run the benchmark of the class ``kind``, and return its exit code; it is 2 for wrong input.

    ``words`` are the command-line arguments, by default those of this process.
    """
    set_passive_waiting()
    try:
        return tyro.cli(kind, args=words).run()
    except InputError as error:
        complain(str(error))
        return 2


def write_rows(out: str, name: str, settings: Mapping[str, Any], rows: Sequence[Mapping[str, Any]]) -> Path:
    """Write the rows of a result, its settings and the hardware to the JSON file ``name`` in the folder ``out``.

    Return the folder, which is created if necessary.
    """
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    content = {"settings": settings, "hardware": machine.hardware(), "rows": rows}
    (folder / name).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return folder


@contextmanager
def measuring(console: Console, steps: int) -> Iterator[Callable[[], None]]:
    """Show a progress bar of ``steps`` steps during the ``with`` block; yield a function that advances it by a step."""
    with progress_bar(console, disable=not console.is_terminal) as bar:
        task = bar.add_task("measuring", total=steps)
        yield lambda: bar.advance(task)
