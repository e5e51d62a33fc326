"""Define ``asg report``, which writes the report page and tables of finished runs."""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from activestructure_gym.errors import FullDisk, InputError, pluralised
from activestructure_gym.evaluation.cli.closing import print_page
from activestructure_gym.evaluation.cli.fields import Out, Switch, Text, option
from activestructure_gym.evaluation.cli.options import parse_labels, split_list
from activestructure_gym.evaluation.cli.output import make_console, print_whole
from activestructure_gym.streams import escape


@dataclass(frozen=True)
class Report:
    """Write the report page and tables of finished runs.

    The page is one file and needs no network; the tables are Markdown, CSV and LaTeX.
    """

    runs: Annotated[tuple[str, ...], tyro.conf.Positional, option("RUN [RUN ...]", "")]
    """Report on these: directories of comparisons or runs, made under the same conditions."""
    out: Out = None
    """Write the report into this directory (default: the comparison's, else runs/report-<date>-<time>)."""
    baseline: Text = None
    """Compare the others with this policy (default: the first of activestructure-a, pixel_only and random)."""

    labels: Annotated[tuple[str, ...], option("NAME=TEXT [NAME=TEXT ...]", "")] = ()
    """Show TEXT as the name of a policy or scene, e.g. activestructure=Ours."""

    columns: Annotated[tuple[str, ...], option("KEY [KEY ...]", "")] = ()
    """Write a table of these metrics too, tables/chosen.tex (.md, .csv), e.g. completion_ratio,psnr,metres."""

    paper_tables: Switch = False
    """Add Tables 1 and 2 of the paper, with its published values next to these runs."""

    wide: Switch = False
    """Print all columns scene by scene, whatever the width of the terminal."""

    def run(self) -> int:
        """Write the report and print the overview; return 0 if it has all requested runs, 1 if some are missing."""
        from activestructure_gym.evaluation.archive.store import COMPARISON

        if not self.runs:
            raise InputError("name the directory of a comparison or of a run to report on")
        directories = [Path(name) for name in self.runs]
        alone = len(directories) == 1 and (directories[0] / COMPARISON).is_file()
        out = Path(self.out or (directories[0] if alone else time.strftime("runs/report-%Y%m%d-%H%M%S")))
        if out.exists() and not out.is_dir():
            raise InputError(f"the output '{out}' is a file; give a directory")

        from activestructure_gym.evaluation.cli.result_table import print_result
        from activestructure_gym.evaluation.report.results import gather
        from activestructure_gym.evaluation.report.summary import write_results
        from activestructure_gym.evaluation.report.tables.columns import chosen_columns
        from activestructure_gym.evaluation.report.tables.overview import as_rich_table
        from activestructure_gym.evaluation.report.tables.paper import ablation_table

        console = make_console()
        results = gather(directories, self.baseline, parse_labels(self.labels))
        chosen = []
        if self.columns:
            aspect = chosen_columns(split_list(self.columns), results.runs)
            chosen.append(dataclasses.replace(ablation_table(results, aspect), name="chosen", title="Chosen columns"))
        try:
            with console.status("drawing"):
                files = write_results(out, results, published=self.paper_tables, more=chosen)
        except FullDisk as error:
            raise FullDisk(
                f"{error}. The runs are complete: free some disk space, then give the same command again"
            ) from error
        console.print(pluralised(len(results.runs), "run"))
        left_out = print_result(console, results.runs, wide=self.wide)
        if self.paper_tables:
            from activestructure_gym.evaluation.report.tables.published import published_tables

            for table in published_tables(results)[::2]:  # averages; the report has the tables by scene
                print_whole(console, as_rich_table(table), wide=self.wide)
                console.print(f"{escape(table.caption)}.\n")
        for name, why in results.missing.items():
            console.print(f"[red]✗[/] missing: {escape(name)}  [red]{escape(why)}[/]")
        if left_out:
            console.print("All columns, scene by scene: --wide, and results.csv next to the page.")
        for table in chosen:
            print_whole(console, as_rich_table(table), wide=self.wide)
        console.print("Tables for papers are in tables/ next to the page.")
        print_page(console, files[-1])
        return 1 if results.missing else 0
