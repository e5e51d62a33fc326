"""Define ``asg why``, which explains a decision of a finished run."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from activestructure_gym.evaluation.cli.fields import Count, NoNames, Switch, option
from activestructure_gym.evaluation.cli.listing import print_json
from activestructure_gym.evaluation.cli.options import split_policies, use_trust
from activestructure_gym.evaluation.cli.output import make_console, plain_table, print_whole, working
from activestructure_gym.streams import escape

if TYPE_CHECKING:
    from activestructure_gym.evaluation.replay.why import ExplainedRow, Explanation


@dataclass(frozen=True)
class Why:
    """Explain why a view was chosen.

    The command prints the best candidates of a decision of a finished run, with their scores and features. With --truth
    or --policies it plays the run again up to the decision.
    """

    run_directory: Annotated[str, tyro.conf.Positional, option("RUN")]
    """Explain a decision of this run (in jobs/ of a comparison)."""
    decision: Count = None
    """Explain this decision, from 0 (default: the last one)."""
    policies: NoNames = ()
    """Print the choices of these policies in the same state as well."""
    truth: Switch = False
    """Print the true surface (m²) that the path to each view would have shown for the first time."""
    json: Switch = False
    """Print JSON."""
    trust_code: Switch = False
    """Run code (package.module:Name) that the run's files name."""

    def run(self) -> int:
        """Print the explanation, and return 0."""
        from activestructure_gym.evaluation.archive.store import read_run
        from activestructure_gym.evaluation.replay.why import explain

        use_trust(self.trust_code)
        console, run = make_console(), read_run(Path(self.run_directory))
        number = len(run.steps) - 1 if self.decision is None else self.decision
        with working(console, "reading the run") as say:
            found = explain(
                run,
                number,
                split_policies(self.policies),
                lambda done, of: say(f"playing the run again: {done} of {of} decisions"),
                truth=self.truth,
                trusted=self.trust_code,
            )
        if self.json:
            return print_json({"run": run.job.title, **dataclasses.asdict(found)})
        title = f"{run.job.title}: decision {number}, frame {found.frame}, {found.candidates} candidates"
        print_whole(console, _table(escape(title), found))
        console.print(escape(found.reason))
        if found.trace:
            console.print(escape("policy: " + ", ".join(f"{key} {_said(value)}" for key, value in found.trace.items())))
        if found.divergence:
            console.print(f"[yellow]{escape(found.divergence)}: the code or the machine differs[/]")
        if self.truth and not run.has_truth:
            console.print("There is no ground truth, so the surface that each view would have shown is unknown.")
        return 0


def _table(title: str, found: Explanation) -> Any:
    numbers = list(dict.fromkeys(name for row in found.rows for name in (*row.terms, *row.features)))
    truth = any(row.new_m2 is not None for row in found.rows)
    heads = ["rank", "row", "score", "x y z", "yaw", "pitch", "path", "frames", *numbers]
    table = plain_table(title, *heads, *(["new m²"] if truth else []), "chosen by")
    for row in found.rows:
        table.add_row(*map(escape, _cells(row, numbers, truth)))
    return table


def _cells(row: ExplainedRow, numbers: Sequence[str], truth: bool) -> list[str]:
    known = {**row.features, **row.terms}
    return [
        _said(row.rank),
        str(row.row),
        _said(row.score),
        " ".join(f"{value:.2f}" for value in row.position),
        f"{row.yaw_deg:.0f}°",
        f"{row.pitch_deg:.0f}°",
        f"{row.metres:.2f} m",
        str(row.frames),
        *(_said(known.get(name)) for name in numbers),
        *(["-" if row.new_m2 is None else f"{row.new_m2:.2f}"] if truth else []),
        ", ".join(row.chosen_by),
    ]


def _said(value: Any) -> str:
    if isinstance(value, dict):
        return "(" + ", ".join(f"{key} {_said(entry)}" for key, entry in value.items()) + ")"
    return "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
