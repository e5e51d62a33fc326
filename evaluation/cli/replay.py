"""``asg replay``: one run, or two side by side, as a page to watch."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.markup import escape

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.fields import PathName, option
from activestructure_gym.evaluation.cli.output import make_console

MOST_RUNS = 2


@dataclass(frozen=True)
class Replay:
    """Play a finished run again and write it as one page: the map as it grows, the camera, planes, candidates, curves.

    The page needs no server, no network and no other file. Two runs stand side by side on one clock.
    """

    runs: Annotated[tuple[str, ...], tyro.conf.Positional, option("RUN [RUN]", "")]
    """Directories of one or two finished runs (a comparison's are in jobs/), or of a comparison of one or two."""
    out: PathName = None
    """The page; replay.html in the run's directory, or where you are if there are two."""

    def run(self) -> int:
        """Play, write, say where."""
        directories = [found for name in self.runs for found in _runs_of(Path(name))]
        if not 1 <= len(directories) <= MOST_RUNS:
            raise InputError(
                f"asg replay takes one run or two, got {len(directories)}: name their directories in jobs/"
            )
        out = Path(self.out or (directories[0] / "replay.html" if len(directories) == 1 else "replay.html"))
        if out.is_dir() or not out.absolute().parent.is_dir():
            raise InputError(f"--out is a file in a directory that exists, got '{out}'")

        from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

        from activestructure_gym.evaluation.archive.store import read_run
        from activestructure_gym.evaluation.replay import play_again, write_replay

        console = make_console()
        began, recordings = time.monotonic(), []
        columns = TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed} of {task.total} frames")
        with Progress(*columns, TimeRemainingColumn(), console=console, transient=True) as progress:
            for directory in directories:
                run = read_run(directory)
                task = progress.add_task(escape(f"playing {run.job.title}"), total=run.metrics["metrics"]["frames"])

                def tell(frames: int, _: int, task: TaskID = task) -> None:
                    progress.update(task, completed=frames)

                recordings.append(play_again(run, tell))
        for recording in recordings:
            if recording.differs:
                console.print(f"[yellow]{escape(recording.run.job.title)}: {escape(recording.differs)}[/]")
        size = write_replay(recordings, out)
        console.print(
            f"Open [bold]{escape(str(out))}[/] in a browser: {size / 1e6:.1f} MB, {time.monotonic() - began:.0f} s"
        )
        return 0


def _runs_of(directory: Path) -> list[Path]:
    """A finished run's own directory, or those of a comparison's finished runs."""
    from activestructure_gym.evaluation.archive.store import COMPARISON, DONE, JOBS

    if (directory / DONE).is_file():
        return [directory]
    if (directory / COMPARISON).is_file():
        return sorted(mark.parent for mark in (directory / JOBS).glob(f"*/{DONE}"))
    raise InputError(f"'{directory}' is neither a finished run nor a comparison")
