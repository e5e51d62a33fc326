"""``asg report``: from finished runs to the page and the tables."""

from __future__ import annotations

import time
from pathlib import Path

from rich.markup import escape

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.commands import Report
from activestructure_gym.evaluation.cli.output import make_console, print_whole


def report(options: Report) -> int:
    """Write the report and print the overview; 0 if every run that was asked for is in it, 1 if some are missing."""
    from activestructure_gym.evaluation.archive.store import COMPARISON

    if not options.runs:
        raise InputError("asg report needs the directory of a comparison or of a run")
    directories = [Path(name) for name in options.runs]
    alone = len(directories) == 1 and (directories[0] / COMPARISON).is_file()
    out = Path(options.out or (directories[0] if alone else time.strftime("runs/report-%Y%m%d-%H%M%S")))
    if out.exists() and not out.is_dir():
        raise InputError(f"the output '{out}' is a file; give a directory")

    from activestructure_gym.evaluation.report.results import gather
    from activestructure_gym.evaluation.report.summary import write_results
    from activestructure_gym.evaluation.report.tables import rich_table, table_rows

    console = make_console()
    results = gather(directories, options.baseline)
    with console.status("drawing"):
        files = write_results(out, results)
    print_whole(console, rich_table(table_rows(results.runs), title=f"{len(results.runs)} runs"))
    for name, why in results.missing.items():
        console.print(f"[red]✗[/] missing: {escape(name)}  [red]{escape(why)}[/]")
    console.print(f"\nOpen [bold]{escape(str(files[-1]))}[/] in a browser; tables for papers are beside it, in tables/")
    return 1 if results.missing else 0
