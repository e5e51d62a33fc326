"""A page of rows that can be played again: per task a table of policies, each with what is known of its runs here.

A task is a set of scenes and seeds under one configuration; only policies that played all of it are ranked.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from activestructure_gym.errors import counted
from activestructure_gym.evaluation.archive.jobs import REFERENCE, TRAJECTORY, Job, is_reference
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.archive.verified import REFUTED, Verification
from activestructure_gym.evaluation.report.columns import RATIOS, Column, value_of
from activestructure_gym.evaluation.report.html import html_table, render
from activestructure_gym.evaluation.report.layout import Cell, Heading, Table, number, ranked
from activestructure_gym.evaluation.report.page import CONTENT_POLICY, page_asset
from activestructure_gym.evaluation.report.places import without_places
from activestructure_gym.specs import number_text

COLUMNS = (
    *RATIOS,
    Column("observed_area", "exploration", "%", 1, "highest"),
    Column("psnr", "PSNR", "dB", 2, "highest"),
)
_SORTED_BY = "tsdf_completion_ratio"
Known = Callable[[Run], Verification | None]


@dataclass(frozen=True)
class Row:
    """One policy's runs of a task."""

    policy: str
    runs: tuple[Run, ...]
    known: tuple[Verification | None, ...]  # in the runs' order

    @property
    def reference(self) -> bool:
        """Whether it sees the ground truth, and is no policy."""
        return is_reference(self.runs[0].job.policy)

    @property
    def plans(self) -> bool:
        """Whether it chose its views itself, by what it had seen: neither a reference nor given poses."""
        return not self.reference and not self.runs[0].job.policy.startswith(TRAJECTORY)

    @property
    def verified(self) -> int:
        """Runs of which every byte came out again here."""
        return sum(one is not None and one.verdict == "identical" for one in self.known)

    @property
    def incomparable(self) -> int:
        """Runs that can neither be confirmed nor refuted here."""
        return sum(one is not None and one.verdict == "not comparable here" for one in self.known)

    @property
    def refuted(self) -> int:
        """Runs that differ or are damaged."""
        return sum(one is not None and one.verdict in REFUTED for one in self.known)

    @property
    def status(self) -> str:
        """What a reader may rely on, in words."""
        if self.refuted:
            return f"refuted: {counted(self.refuted, 'run')} came out otherwise"
        told = f", {self.incomparable} not comparable here" if self.incomparable else ""
        if not self.verified:
            return f"self-reported{told}"
        if self.verified == len(self.runs):
            return "verified"
        return f"verified {self.verified} of {len(self.runs)} runs, others self-reported{told}"

    @property
    def command(self) -> str:
        """What plays these runs again from nothing."""
        job = self.runs[0].job
        scenes = list(dict.fromkeys(run.job.scene for run in self.runs))
        seeds = sorted({run.job.seed for run in self.runs})
        who = ["--policies", job.policy]
        if self.reference:
            who = ["--policies", "random", "--references", job.policy.removeprefix(REFERENCE)]
        words = ["asg", "compare", "--scenes", *scenes, *who, "--seeds", *map(str, seeds)]
        words += ["--preset", job.preset]
        words += ["--terms", job.terms] if job.terms != "shared" else []
        words += ["--frames", str(job.frame_budget)] if job.frame_budget is not None else []
        changes = [f"{name}={value if isinstance(value, str) else json.dumps(value)}" for name, value in job.overrides]
        words += ["--set", *changes] if changes else []
        if job.start_pose is not None:
            words.append("--start=" + ",".join(map(number_text, job.start_pose)))
        words += ["--protocols", "standard", *job.also] if job.also else []
        usual = type(job.protocol)()
        for name, option in (("views", "--views"), ("surface_samples", "--samples"), ("view_source", "--view-source")):
            if (asked := getattr(job.protocol, name)) != getattr(usual, name):
                words += [option, str(asked)]
        return without_places(shlex.join(words))


def task_of(job: Job) -> str:
    """What two runs must share, besides scene and seed, to stand in one table."""
    content = job.as_dict()
    for name in ("scene", "scene_hash", "seed", "policy"):
        del content[name]
    return json.dumps(content, sort_keys=True)


def rows_of(runs: Sequence[Run], known: Known) -> list[tuple[list[Row], int]]:
    """The tasks, each with its rows, those that ranked by C.R. of the surface first, and its number of runs."""
    tasks: dict[str, list[Run]] = {}
    for run in _each_once(runs, known):
        tasks.setdefault(task_of(run.job), []).append(run)
    found = []
    for mine in tasks.values():
        wanted = len({_place(run) for run in mine})
        policies = dict.fromkeys(run.policy for run in mine)
        rows = [_row([run for run in mine if run.policy == policy], known) for policy in policies]
        whole = [row for row in rows if _is_ranked(row, wanted)]
        whole.sort(key=lambda row: -(_mean(row, _SORTED_BY) or 0.0))
        others = [row for row in rows if not _is_ranked(row, wanted)]
        others.sort(key=lambda row: row.refuted > 0)  # a stable sort: refuted rows come last
        found.append((whole + others, wanted))
    return found


def _each_once(runs: Sequence[Run], known: Known) -> list[Run]:
    """The runs, of those of the same job one that came out again, else one that did not, else the first."""
    found: dict[str, list[Run]] = {}
    for run in runs:
        found.setdefault(run.key, []).append(run)
    return [max(same, key=lambda run: _weight(known(run))) if len(same) > 1 else same[0] for same in found.values()]


def _weight(found: Verification | None) -> int:
    verdict = None if found is None else found.verdict
    return 2 if verdict == "identical" else 1 if verdict in REFUTED else 0


def leaderboard_page(runs: Sequence[Run], known: Known, refused: Mapping[str, str]) -> str:
    """The whole page; ``refused`` are directories that could not be read, with the reason."""
    tasks = rows_of(runs, known)
    sections = [_section(number, *task) for number, task in enumerate(tasks, start=1)]
    rows = [row for found, _ in tasks for row in found]
    title = f"Leaderboard: {counted(len(rows), 'row')}, {counted(len(runs), 'run')}"
    body = render(
        "leaderboard.html.j2",
        title=title,
        verified=sum(row.verified == len(row.runs) for row in rows),
        rows=len(rows),
        refused={without_places(name): without_places(reason) for name, reason in refused.items()},
        sections=sections,
    )
    return render(
        "page.html.j2",
        policy=CONTENT_POLICY,
        title=title,
        style=page_asset("report.css"),
        links=[(f"task-{number}", f"task {number}") for number in range(1, len(tasks) + 1)],
        body=body,
        script=page_asset("report.js"),
    )


def _section(place: int, rows: Sequence[Row], wanted: int) -> Markup:
    job, run = rows[0].runs[0].job, rows[0].runs[0]
    ranks = [_is_ranked(row, wanted) for row in rows]
    columns = [_column(rows, column, ranks) for column in COLUMNS]
    table = Table(
        f"task-{place}",
        f"Task {place}",
        [Heading("policy", numeric=False), *(Heading.of(column) for column in COLUMNS), Heading("runs"),
         Heading("status", numeric=False), Heading("made on", numeric=False), Heading("code", numeric=False)],
        [
            [Cell(row.policy), *(column[index] for column in columns), number(len(row.runs), 0), _status(row),
             Cell(_made_on(row)), Cell(_code(row))]
            for index, row in enumerate(rows)
        ],
        caption="Means over scenes of means over seeds" + _without_rank(rows, wanted),
    )  # fmt: skip
    scenes = sorted({without_places(run.job.scene) for row in rows for run in row.runs})
    facts = [
        f"{counted(len(scenes), 'scene')}: {', '.join(scenes)}",
        f"{job.terms} terms, preset {job.preset}, {run.config['configuration']['frame_budget']} frames, protocol "
        f"{job.protocol.name} {job.protocol.parameters()['version']}"
        + (f", {', '.join(f'{name}={value}' for name, value in job.overrides)}" if job.overrides else ""),
    ]
    again = [
        {
            "policy": row.policy,
            "command": row.command,
            "runs": [
                {
                    "title": without_places(one.job.title),
                    "scene": one.config["scene"].get("content_hash", ""),
                    "map": one.sums.get("map.npz", ""),
                    "metrics": one.sums.get("metrics.json", ""),
                    "said": "self-reported" if found is None else "; ".join((found.verdict, *found.why)),
                }
                for one, found in zip(row.runs, row.known)
            ],
        }
        for row in rows
    ]
    return render("leaderboard_task.html.j2", anchor=f"task-{place}", facts=facts, table=html_table(table), again=again)


def _without_rank(rows: Sequence[Row], wanted: int) -> str:
    """Why some of the rows have no rank, for the caption; empty where all have one."""
    if all(_is_ranked(row, wanted) for row in rows):
        return ""
    refuted = ", nor has one of which a run came out otherwise" if any(row.refuted for row in rows) else ""
    return f"; of fewer than {wanted} runs, of a reference or of given poses, a row has no rank{refuted}"


def _row(runs: Sequence[Run], known: Known) -> Row:
    mine = tuple(sorted(runs, key=lambda run: (run.scene, run.job.seed)))
    return Row(mine[0].policy, mine, tuple(known(run) for run in mine))


def _is_ranked(row: Row, wanted: int) -> bool:
    """Whether a policy played all of the task, and no run was refuted; a reference is none, nor are given poses."""
    return len(row.runs) == wanted and row.plans and not row.refuted


def _place(run: Run) -> tuple[str, int]:
    return run.job.scene_hash or run.job.scene, run.job.seed


def _mean(row: Row, key: str) -> float | None:
    by_scene: dict[str, list[float]] = {}
    for run in row.runs:
        value = value_of(run, key)
        if value is None:
            return None
        by_scene.setdefault(_place(run)[0], []).append(value)
    return float(np.mean([np.mean(values) for values in by_scene.values()]))


def _column(rows: Sequence[Row], column: Column, ranks: Sequence[bool]) -> list[Cell]:
    return ranked([number(_mean(row, column.key), column.digits) for row in rows], column, ranks)


def _status(row: Row) -> Cell:
    return Cell(row.status, tone="bad" if row.refuted else "good" if row.verified == len(row.runs) else "")


def _made_on(row: Row) -> str:
    return ", ".join(dict.fromkeys(str(run.timing["hardware"]["processor"]) for run in row.runs))


def _code(row: Row) -> str:
    versions = (run.config["versions"] for run in row.runs)
    return ", ".join(dict.fromkeys(f"{v['activestructure-gym']} {v.get('code', '')[:8]}".strip() for v in versions))
