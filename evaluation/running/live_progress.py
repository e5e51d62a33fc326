"""Show the progress of a comparison in a terminal or a log."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from types import TracebackType

from rich.cells import cell_len
from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID, TextColumn
from rich.table import Column
from rich.text import Text

from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.machine.terminal import shortened
from activestructure_gym.evaluation.running import episode
from activestructure_gym.evaluation.running.engines import Outcome
from activestructure_gym.streams import escape

_REST_SHARE = 0.1  # assumed share of a job's time after its last frame, for measuring and writing
_QUIET = 30.0  # seconds without output after which a log gets a line about the running jobs
_WIDE = 110  # columns of a terminal with room for long bars
_WIDE_BAR, _NARROW_BAR, _MIN_BAR = 24, 8, 8  # columns
_NUMBERS = 48  # columns of frames, completion ratio, time left and stage, including the gaps


class LiveProgress:
    """Show one bar per running job and one for all jobs; print finished jobs above the bars.

    If the output is not a terminal, write lines instead: one per finished job with the count of finished jobs and the
    time left, and one about the running jobs after 30 seconds without output. The object is a context manager and a
    `Listener`.
    """

    def __init__(self, console: Console) -> None:
        self._console, self._jobs = console, 0
        bar = _WIDE_BAR if console.width >= _WIDE else _NARROW_BAR
        self._room = max(console.width - bar - _NUMBERS, _MIN_BAR)  # columns of a title
        self._display = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=bar),
            TextColumn("{task.fields[frames]}", justify="right"),
            TextColumn("{task.fields[coverage]}", justify="right"),
            _Left(Column(no_wrap=True)),
            TextColumn("[dim]{task.fields[stage]}"),
            console=console,
            refresh_per_second=4,
            transient=True,
            disable=not console.is_terminal,
        )
        self._bars: dict[str, _Bar] = {}
        self._began = time.monotonic()
        self._ended = 0
        self._whole: TaskID | None = None
        self._said = time.monotonic()
        self._over = threading.Event()

    def __enter__(self) -> LiveProgress:
        self._display.start()
        if not self._console.is_terminal:
            threading.Thread(target=self._keep_saying, daemon=True, name="progress of a comparison").start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._display.stop()

    def begin(self, jobs: Sequence[Job], finished: int) -> None:
        """See `Listener.begin`."""
        self._began, self._jobs = time.monotonic(), len(jobs)
        if finished:
            self._say(f"[dim]{finished} finished before, {len(jobs)} to run")
        self._whole = self._display.add_task(
            "[bold]all runs", total=max(1, len(jobs)), frames=f"0/{len(jobs)}", coverage="", stage="", left=None
        )

    def progress(self, job: Job, progress: episode.Progress) -> None:
        """See `Listener.progress`."""
        if job.name not in self._bars:
            title = escape(shortened(job.title, self._room, _ellipsis(self._console)))
            task = self._display.add_task(title, total=1.0, frames="", coverage="", stage="", left=None)
            self._bars[job.name] = _Bar(task, job.title)
        bar = self._bars[job.name]
        left = bar.seconds_left(progress)
        share = 0.0 if not progress.frame_budget else progress.frames / progress.frame_budget * (1 - _REST_SHARE)
        bar.share = 1.0 if progress.stage == "done" else min(share, 1.0)
        ratio = progress.completion_ratio
        self._display.update(
            bar.task,
            completed=bar.share,
            frames=f"{progress.frames}/{progress.frame_budget}" if progress.frame_budget else "",
            coverage="" if ratio is None else f"C.R. {ratio:5.1f} %",
            stage=progress.stage,
            left=left,
        )
        self._update_whole()

    def on_retry(self, job: Job, error: str) -> None:
        """See `Listener.on_retry`."""
        bar = self._bars.pop(job.name, None)
        if bar is not None:
            self._display.remove_task(bar.task)
        text = f"[yellow]↻[/] {escape(job.title)}  [yellow]{escape(error)}; will be tried again"
        self._say(text)
        self._update_whole()

    def ended(self, outcome: Outcome) -> None:
        """See `Listener.ended`."""
        self._ended += 1
        bar = self._bars.pop(outcome.job.name, None)
        words: list[str] = []
        if bar is not None:
            task = next(task for task in self._display.tasks if task.id == bar.task)
            facts = [f"{task.fields['frames']} frames" if task.fields["frames"] else "", task.fields["coverage"]]
            words = [*filter(None, facts), f"{time.monotonic() - bar.began:.0f} s"]
            self._display.remove_task(bar.task)
        left = self._update_whole()
        rest = []
        if not self._console.is_terminal and self._ended < self._jobs:
            rest = [f"{self._ended}/{self._jobs}" + (f", {_clock(left)} left" if left is not None else "")]
        if outcome.finished:
            self._say(f"[green]✓[/] {escape(outcome.job.title)}", *words, *rest)
        else:
            self._say(f"[red]✗[/] {escape(outcome.job.title)}  [red]{escape(outcome.error or '')}[/]", *rest)

    def _say(self, text: str, *facts: str) -> None:
        """Print the text and the facts in one line, or in two lines if they are too long for one."""
        self._said = time.monotonic()
        tail = "  ".join(facts)
        line = self._console.render_str(f"{text}  {tail}").plain
        gap = "  " if cell_len(line) <= self._console.width else "\n  "
        self._console.print(f"{text}{gap if facts else ''}[dim]{escape(tail)}[/]", highlight=False)

    def _keep_saying(self) -> None:
        """Write the state of all jobs to a log after every 30 seconds without output."""
        while not self._over.wait(_QUIET / 30):
            if time.monotonic() - self._said > _QUIET:
                self._say(f"[dim]{escape(self._state())}")

    def _state(self) -> str:
        tasks = {task.id: task for task in self._display.tasks}
        running = []
        for bar in list(self._bars.values()):
            if (task := tasks.get(bar.task)) is not None:
                words = (bar.title, task.fields["frames"], task.fields["coverage"], task.fields["stage"])
                running.append("  ".join(word for word in words if word))
        return f"{self._ended}/{self._jobs} done, {time.monotonic() - self._began:.0f} s: " + (
            "; ".join(running) or "starting"
        )

    def _update_whole(self) -> float | None:
        """Update the bar of all jobs; return the estimated seconds left, None at the beginning."""
        done = self._ended + sum(bar.share for bar in self._bars.values())
        spent = time.monotonic() - self._began
        left = spent / done * (self._jobs - done) if done > 0.05 else None
        if self._whole is not None:
            self._display.update(self._whole, completed=done, frames=f"{self._ended}/{self._jobs}", left=left)
        return left


class _Bar:
    """Hold the bar of one running job and estimate its remaining time."""

    def __init__(self, task: TaskID, title: str) -> None:
        self.task, self.title = task, title
        self.began = time.monotonic()
        self.share = 0.0
        self._first: tuple[float, int] | None = None  # time and frame of the first decision

    def seconds_left(self, progress: episode.Progress) -> float | None:
        """Estimate the seconds left from the speed since the first decision, without loading and compiling before."""
        if progress.stage != "exploring":
            return None
        now = time.monotonic()
        if self._first is None:
            self._first = (now, progress.frames)
            return None
        frames = progress.frames - self._first[1]
        if frames <= 0:
            return None
        remaining = max(0, progress.frame_budget - progress.frames)
        return (now - self._first[0]) / frames * remaining


def _ellipsis(console: Console) -> str:
    return "..." if console.options.ascii_only else "…"


class _Left(ProgressColumn):
    """Show the time left."""

    def render(self, task: Task) -> Text:
        """Return the text of the column."""
        left = task.fields.get("left")
        if left is None:
            return Text("", style="cyan")
        return Text(f"{_clock(left)} left", style="cyan")


def _clock(seconds: float) -> str:
    """Format seconds as M:SS or H:MM:SS."""
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"
