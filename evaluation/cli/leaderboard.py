"""``asg leaderboard``: a page of rows that can be played again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from activestructure_gym.errors import InputError, counted, listed
from activestructure_gym.evaluation.cli.closing import print_page
from activestructure_gym.evaluation.cli.fields import PathName, Runs
from activestructure_gym.evaluation.cli.output import make_console
from activestructure_gym.streams import escape


@dataclass(frozen=True)
class Leaderboard:
    """Make a page of policies, each with its runs' numbers, their sums, and whether they came out again here.

    A row is self-reported until `asg verify` played its runs again on this machine. Runs that are damaged are left out
    and named.
    """

    runs: Runs = ()
    """Directories of comparisons, or of runs."""
    out: PathName = None
    """The page; leaderboard.html where you are if not given."""

    def run(self) -> int:
        """Write the page; 0 if all runs are in it, 1 if some could not be read."""
        from activestructure_gym.evaluation.archive.comparison import each_run
        from activestructure_gym.evaluation.archive.temporary import writing
        from activestructure_gym.evaluation.archive.verified import known
        from activestructure_gym.evaluation.report.leaderboard import leaderboard_page
        from activestructure_gym.files import replaced

        if not self.runs:
            raise InputError("name the directories of comparisons or of runs to put on the page")
        out = Path(self.out or "leaderboard.html")
        if out.is_dir() or not out.absolute().parent.is_dir():
            raise InputError(f"--out is a file in a directory that exists, got '{out}'")
        console = make_console()
        with console.status("reading"):
            runs, refused = each_run([Path(name) for name in self.runs])
        if not runs:
            raise InputError("; ".join(refused.values()) or f"there is no finished run in {listed(self.runs)}")
        with writing(out), replaced(out) as file:
            file.write(leaderboard_page(runs, lambda run: known(run.directory), refused).encode())
        for reason in refused.values():
            console.print(f"[red]✗[/] left out: {escape(reason)}")
        console.print(counted(len(runs), "run"))
        print_page(console, out)
        return 1 if refused else 0
