"""Show the progress of a training run in a terminal or in a log."""

from __future__ import annotations

import time
from collections.abc import Mapping

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Column

from activestructure_gym.evaluation.machine.terminal import shortened
from activestructure_gym.streams import escape

_SHOWN = ("train/loss", "train/agreement", "rollout/reward_per_episode", "train/approx_kl")  # numbers next to the bar
_WIDE = 110  # characters; in a terminal of at least this width, progress bars are long
_TITLE, _OTHERS = 28, 52  # characters; widest title, and width of all parts except bar, numbers and stage


def _joined(entries: list[str], width: int) -> str:
    """Join as many leading entries as fit into ``width`` characters."""
    while entries and len("  ".join(entries)) > width:
        entries = entries[:-1]
    return "  ".join(entries)


class Live:
    """Show a progress bar with the latest training numbers, and print validation scores above it.

    Use the object as a context manager.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        bar = 24 if console.width >= _WIDE else 8
        self._room = max(console.width - bar - _OTHERS, 0)  # characters for the numbers or the stage
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=bar),
            TextColumn("{task.completed:.0f}/{task.total:.0f}"),
            TextColumn("{task.fields[numbers]}"),
            TimeRemainingColumn(table_column=Column(no_wrap=True)),
            TextColumn("[dim]{task.fields[stage]}"),
            console=console,
            refresh_per_second=4,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task: TaskID | None = None
        self._steps, self._tenth = 0, 0
        self._last = (0, time.monotonic())

    def __enter__(self) -> Live:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def begin(self, title: str, total: int, done: int, steps: int = 0) -> None:
        """Begin a new bar for ``total`` units, ``done`` of which are finished.

        A unit is an epoch, an iteration or a file. If ``steps``, the environment steps per unit, is given, steps per
        second are shown.
        """
        if self._task is not None:
            self._progress.remove_task(self._task)
        short = escape(shortened(title, _TITLE))
        self._task = self._progress.add_task(short, total=total, completed=done, numbers="", stage="")
        self._steps, self._last = steps, (done, time.monotonic())
        self._tenth = 0
        if not self._console.is_terminal:
            self._console.print(escape(title) + (f", {done} of {total} done before" if done else ""), highlight=False)

    def note(self, text: str) -> None:
        """Print the line ``text``."""
        self._console.print(escape(text), highlight=False)

    def say(self, stage: str) -> None:
        """Show the text ``stage`` next to the bar."""
        if self._task is not None:
            self._progress.update(self._task, stage=escape(shortened(stage, self._room)))

    def files(self, done: int, total: int) -> None:
        """Show that ``done`` of ``total`` files or episodes are finished."""
        if self._task is not None:
            self._progress.update(self._task, completed=done, total=total)
        if not self._console.is_terminal and 10 * done // max(1, total) > self._tenth:
            self._tenth = 10 * done // max(1, total)
            self._console.print(f"[dim]{done}/{total}", highlight=False)

    def unit(self, done: int, row: Mapping[str, float]) -> None:
        """Show that ``done`` epochs or iterations are finished, and show the numbers of the log row ``row``."""
        numbers = [f"{name.rpartition('/')[2]} {row[name]:.3g}" for name in _SHOWN if name in row]
        if self._steps and done > self._last[0]:
            seconds = time.monotonic() - self._last[1]
            numbers.append(f"{self._steps * (done - self._last[0]) / max(seconds, 1e-9):.0f} steps/s")
        self._last = (done, time.monotonic())
        if self._task is not None:
            self._progress.update(self._task, completed=done, numbers=_joined(numbers, self._room), stage="")
        if "validation/normalised" in row:
            self._console.print(
                f"[green]✓[/] after {done}: coverage {100 * row['validation/auc']:.1f} %, normalised "
                f"{row['validation/normalised']:.3f}[dim]  {'  '.join(numbers)}",
                highlight=False,
            )
