"""Define ``asg verify``, which plays finished runs again and compares them with the stored files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.fields import Runs, Switch
from activestructure_gym.evaluation.cli.options import use_trust
from activestructure_gym.evaluation.cli.output import make_console, progress_bar, short_title
from activestructure_gym.streams import escape

if TYPE_CHECKING:
    from rich.progress import TaskID

    from activestructure_gym.evaluation.running.episode import Progress

_MARKS = {"identical": "[green]✓[/]", "not comparable here": "[yellow]?[/]"}
_NOT_COMPARABLE = 3  # exit code if a run is not comparable on this machine


@dataclass(frozen=True)
class Verify:
    """Play finished runs again and compare them byte for byte.

    A run is identical, differs, or is damaged. If the bytes differ on another processor or with other versions than
    recorded, the run is not comparable here. Exit codes: 0, all runs are identical; 1, a run differs, is damaged or
    cannot be played; 3, a run is not comparable here.
    """

    runs: Runs = ()
    """Verify these: directories of runs or of comparisons."""
    trust_code: Switch = False
    """Run code (package.module:Name) that the runs' files name."""

    def run(self) -> int:
        """Play each run again, print its verdict (identical, differs, ...), and return the exit code."""
        use_trust(self.trust_code)
        from rich.progress import Progress as Bar
        from rich.progress import TextColumn

        from activestructure_gym.evaluation.archive.comparison import verified_runs
        from activestructure_gym.evaluation.reproduction.verifying import REFUTED, verify

        if not self.runs:
            raise InputError("name the directory of a comparison or of a run to play again")
        console = make_console()
        runs, refused = verified_runs([Path(name) for name in self.runs])
        failed, unplayed, open_ = len(refused), 0, 0
        for reason in refused.values():
            console.print(f"[red]✗[/] damaged: {escape(reason)}")
        for run in runs:
            with progress_bar(console, TextColumn("{task.completed} of {task.total} frames")) as bar:
                title = short_title(console, f"playing {run.job.title}")
                task = bar.add_task(title, total=run.metrics["metrics"]["frames"])

                def update(progress: Progress, bar: Bar = bar, task: TaskID = task) -> None:
                    bar.update(task, completed=progress.frames)

                found = None
                try:
                    found = verify(run, update)
                except Exception as error:  # a policy may raise any error; the remaining runs are still played
                    said = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
            if found is None:
                unplayed += 1
                said = escape(f"{run.job.title}: cannot be played here: {said}")
                console.print(f"[red]✗[/] {said}")
                continue
            failed += found.verdict in REFUTED
            open_ += found.verdict == "not comparable here"
            mark = _MARKS.get(found.verdict, "[red]✗[/]")
            said = f"{mark} {escape(run.job.title)}: {found.verdict}"
            console.print("; ".join((said, *map(escape, found.why))))
        asked = len(runs) + len(refused)
        if failed:
            console.print(f"[red]✗[/] {failed} of {asked} did not come out as stored")
        if open_:
            console.print(f"[yellow]?[/] {open_} of {asked} can neither be confirmed nor refuted on this machine")
        if unplayed:
            console.print(f"[red]✗[/] {unplayed} of {asked} could not be played, so nothing is known of them")
        return 1 if failed or unplayed else _NOT_COMPARABLE if open_ else 0
