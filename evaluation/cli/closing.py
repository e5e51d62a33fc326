"""Print the last lines of a command: the result, the address of the report page, and commands to run next."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.cells import cell_len
from rich.console import Console
from rich.text import Text

from activestructure_gym.errors import FullDisk, pluralised
from activestructure_gym.evaluation.cli.output import print_whole, width_of
from activestructure_gym.streams import complain, escape, flat
from activestructure_gym.worlds.registry import PREFIX, names_world

if TYPE_CHECKING:
    from activestructure_gym.evaluation.archive.store import Run
    from activestructure_gym.evaluation.running.comparison import Result

_INDENT = "  "


def print_end(
    console: Console, result: Result, directory: Path, seconds: float, baseline: str | None, *, wide: bool
) -> int:
    """Write the report of a comparison, print its result and commands to run next, and return the exit code.

    ``seconds`` is the duration of the comparison, and ``baseline`` the label of the policy to compare the others with.
    ``wide`` prints all columns. The exit code is 1 if a run failed, else 0.
    """
    from activestructure_gym.evaluation.archive.comparison import read_record, run_directory
    from activestructure_gym.evaluation.archive.played import is_played
    from activestructure_gym.evaluation.cli.result_table import print_result
    from activestructure_gym.evaluation.report.page.method_text import trajectories_text
    from activestructure_gym.evaluation.report.results import Results
    from activestructure_gym.evaluation.report.summary import write_report
    from activestructure_gym.evaluation.report.tables.columns import invalid_choices, own_absences, truth_absences
    from activestructure_gym.evaluation.report.tables.planning import rich_planning_table
    from activestructure_gym.evaluation.running.measuring import draw_missing_pictures

    if result.skipped:
        console.print(f"{pluralised(result.skipped, 'run')} finished before and kept")
    if result.missing:
        console.print(
            f"[yellow]{pluralised(result.missing, 'run')}[/] of this comparison not finished, and not asked for this "
            "time"
        )
    if result.runs:
        try:
            with console.status("drawing"):
                for run in result.runs:  # a process may have been killed after a run and before its pictures
                    draw_missing_pictures(run)
                files = write_report(directory, result.runs, read_record(directory) or {}, baseline)
        except FullDisk as error:
            again = f"asg report {shlex.quote(str(directory))}"
            raise FullDisk(
                f"{error}. The runs are complete: free some disk space, then `{again}` writes the report"
            ) from error
        console.print()
        left_out = print_result(console, result.runs, wide=wide)
        if (planning := rich_planning_table(Results(result.runs, []))) is not None:
            print_whole(console, planning, wide=wide)
        for text in [
            *truth_absences(result.runs),
            *own_absences(result.runs),
            *invalid_choices(result.runs),
            *trajectories_text(Results(result.runs, [])),
        ]:
            console.print(escape(text.replace("`", "")))
        console.print(
            f"{pluralised(len(result.runs), 'run')}, {seconds:.0f} s. Next to the page: {escape(files[-2].name)}, "
            "tables/ for papers, results.csv and the pictures."
        )
        print_page(console, files[-1])
        wider = [["asg", "report", str(directory), "--wide"]] if left_out else []
        print_next(console, [*next_commands(result.runs), *wider])
    if result.failed:
        what = pluralised(len(result.failed), "run")
        kept = sum(is_played(run_directory(directory, outcome.job)) for outcome in result.failed)
        left = f"; {pluralised(kept, 'episode')} kept, which --resume measures without playing again" if kept else ""
        complain(f"{what} failed; the messages are in {directory / 'logs'}{left}")
    return 1 if result.failed else 0


def print_page(console: Console, page: Path) -> None:
    """Print the ``file://`` address of a page, or its path as a link if the address is wider than the terminal."""
    address, width = page.absolute().as_uri(), width_of(console)
    head = "Open in a browser: "
    if width is None or cell_len(head + address) <= width:
        console.print(Text(head).append(address, "bold"), soft_wrap=True)
        return
    console.print(head.rstrip(), style=None)
    path = address if cell_len(address) <= width - len(_INDENT) else str(page)
    console.print(Text(_INDENT).append(flat(path), f"bold link {address}"), soft_wrap=True)


def print_next(console: Console, commands: Sequence[Sequence[str]]) -> None:
    """Print commands to run next, each given as its words, quoted for a shell."""
    console.print("Next:")
    for words in commands:
        for line in command_lines(words, width_of(console)):
            console.print(Text(flat(line)), soft_wrap=True)


def command_lines(words: Sequence[str], width: int | None) -> list[str]:
    """Return a command, given as its words, as lines of at most ``width`` columns that a shell reads as one command.

    Lines end with a backslash. None as ``width`` breaks nothing. A path wider than a line continues in the first column
    of the next line, which a shell reads as one word. A quoted word is not broken.
    """
    quoted = [shlex.quote(word) for word in words]
    lines = [_INDENT + quoted[0]]
    for word in quoted[1:]:
        if width is None or cell_len(f"{lines[-1]} {word} \\") <= width:
            lines[-1] += f" {word}"
            continue
        lines[-1] += " \\"
        lines.append(2 * _INDENT + word)
        while cell_len(f"{lines[-1]} \\") > width and "/" in lines[-1].strip() and not word.startswith("'"):
            end = lines[-1].rfind("/", 0, width - 2) + 1
            if not end:
                break
            lines[-1:] = [f"{lines[-1][:end]}\\", lines[-1][end:]]
    return lines


def next_commands(runs: Sequence[Run]) -> list[list[str]]:
    """Return two commands as words: `asg replay` of two policies in one scene, and `asg watch` steered by the user."""
    first = runs[0]
    others = [run for run in runs if (run.scene, run.job.seed) == (first.scene, first.job.seed)]
    pair = [first, *(run for run in others if run.policy != first.policy)][:2]
    scene = [] if first.job.scene == "room" else ["--scene", first.job.scene]
    if names_world(first.job.scene):
        scene = ["--world", first.job.scene.removeprefix(PREFIX)]
    return [
        ["asg", "replay", *(str(run.directory) for run in pair)],
        ["asg", "watch", *scene, "--policy", "you"],
    ]
