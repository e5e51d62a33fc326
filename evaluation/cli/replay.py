"""Define ``asg replay``, which writes a page or a video that replays finished runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.progress import TextColumn

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.closing import print_page
from activestructure_gym.evaluation.cli.fields import Out, PathName, Switch, option
from activestructure_gym.evaluation.cli.options import use_trust
from activestructure_gym.evaluation.cli.output import make_console, progress_bar, short_title
from activestructure_gym.streams import escape

if TYPE_CHECKING:
    from rich.console import Console

    from activestructure_gym.evaluation.archive.store import Run

MAX_RUNS = 2


@dataclass(frozen=True)
class Replay:
    """Write a page or a film that replays finished runs.

    The page shows the map as it grows, the camera, planes, candidates and curves; two runs side by side on one clock.
    It needs no server, no network and no other file.
    """

    runs: Annotated[tuple[str, ...], tyro.conf.Positional, option("RUN [RUN]", "")]
    """Replay these: one or two finished runs (in jobs/ of a comparison), or a comparison of one or two."""
    out: Out = None
    """Write this page (default: replay.html in the run's directory, of two runs in the working directory)."""
    video: PathName = None
    """Write a film of 6 s instead, with each map as it grows and a curve: .mp4, .webm, or .webp for web pages."""
    trust_code: Switch = False
    """Run code (package.module:Name) that the runs' files name."""

    def run(self) -> int:
        """Play the runs again, write the page or the video, and print its path."""
        use_trust(self.trust_code)
        directories = [found for name in self.runs for found in _runs_of(Path(name))]
        if not 1 <= len(directories) <= MAX_RUNS:
            raise InputError(f"a replay shows one run or two, got {len(directories)}: name their directories in jobs/")
        from activestructure_gym.evaluation.archive.store import REPLAY, read_run
        from activestructure_gym.evaluation.replay import check_video

        if self.video is not None and self.out is not None:
            raise InputError("--video takes the place of --out: leave out one of the two")
        film = self.video is not None
        out = Path(self.video or self.out or (directories[0] / REPLAY if len(directories) == 1 else REPLAY))
        if film:
            check_video(out)
        if out.is_dir() or not out.absolute().parent.is_dir():
            raise InputError(f"{'--video' if film else '--out'} is a file in a directory that exists, got '{out}'")
        write_page(make_console(), out, [read_run(directory) for directory in directories], film=film)
        return 0


def add_replays(console: Console, runs: Iterable[Run]) -> None:
    """Write replay.html into the directory of every run that has none; print which runs cannot be replayed.

    The runs are trusted: plugins that their files name are imported.
    """
    from activestructure_gym.evaluation.archive.store import REPLAY

    for run in runs:
        page = run.directory / REPLAY
        if not page.exists():
            try:
                write_page(console, page, [run], trusted=True)
            except InputError as error:  # for example for a mapper without Gaussians; the other runs are replayed
                console.print(f"[yellow]no replay of {escape(run.job.title)}: {escape(str(error))}[/]")


def write_page(console: Console, out: Path, runs: Sequence[Run], *, film: bool = False, trusted: bool = False) -> None:
    """Play one or two runs again, write the replay page or, with ``film``, the film to ``out``, and print its place.

    With ``trusted``, plugins that the runs' files name are imported.
    """
    from activestructure_gym.evaluation.archive.temporary import writing
    from activestructure_gym.evaluation.replay import play_again, write_replay, write_video

    began, recordings = time.monotonic(), []
    for run in runs:
        with _progress(console, run) as update:
            recordings.append(play_again(run, update, trusted=trusted))
    for recording in recordings:
        if recording.divergence:
            console.print(f"[yellow]{escape(recording.run.job.title)}: {escape(recording.divergence)}[/]")
    with writing(out):
        if film:
            length = write_video(recordings, out)
        else:
            write_replay(recordings, out)
    size, seconds = out.stat().st_size / 1e6, time.monotonic() - began
    console.print(f"{size:.1f} MB, {seconds:.0f} s")
    if film:
        console.print(f"[bold]{escape(str(out))}[/]: {length:g} s")
    else:
        print_page(console, out)


@contextmanager
def _progress(console: Console, run: Run) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar during the ``with`` block, in which ``run`` is played again.

    Yield the function that updates the bar. Its arguments are the number of frames so far and the frame budget.
    """
    with progress_bar(console, TextColumn("{task.completed} of {task.total} frames")) as progress:
        title = short_title(console, f"playing {run.job.title}")
        task = progress.add_task(title, total=run.metrics["metrics"]["frames"])
        yield lambda frames, budget: progress.update(task, completed=frames)


def _runs_of(directory: Path) -> list[Path]:
    """Return ``directory`` if it is of a finished run, or the directories of all finished runs of a comparison."""
    from activestructure_gym.evaluation.archive.completion import DONE, completion_markers
    from activestructure_gym.evaluation.archive.store import without_runs

    if (directory / DONE).is_file():
        return [directory]
    if markers := completion_markers(directory):
        return [marker.parent for marker in markers]
    raise without_runs(directory)
