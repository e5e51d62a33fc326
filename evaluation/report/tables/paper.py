"""Build tables in the layout of the paper's Tables 1 to 4."""

from __future__ import annotations

import numpy as np

from activestructure_gym.errors import pluralised
from activestructure_gym.evaluation.report.results import Results, once
from activestructure_gym.evaluation.report.tables.columns import Aspect, Column, aspects, reason_of
from activestructure_gym.evaluation.report.tables.layout import (
    MISSING,
    NONE,
    Cell,
    Heading,
    Table,
    number,
    ranked,
    with_interval,
)
from activestructure_gym.evaluation.statistics import estimate, mean
from activestructure_gym.policies.activestructure import LADDER

_VARIANTS = ("Pixel-only", "+ PSG gain", "+ Anomaly detection", "+ Deficiency targeting", "Full model")
NAMES = {rung: f"({letter}) {name}" for rung, letter, name in zip(LADDER, "ABCDE", _VARIANTS)}  # as in Table 3


def quality_table(results: Results, aspect: Aspect, *, average: bool = True) -> Table:
    """Return a table in the layout of Tables 1 and 2: a row per method and metric, and a column per scene.

    ``aspect`` has the metrics. ``average`` adds a column with the average over several scenes.
    """
    columns = aspect.columns
    scenes = [*results.scenes, None] if average and len(results.scenes) > 1 else results.scenes
    cells: dict[tuple[str, str, str | None], Cell] = {}
    for column in columns:
        for scene in scenes:
            means = [_mean(results, policy, column, scene) for policy in results.policies]
            block = ranked(means, column, results.planners)
            cells |= {(policy, column.key, scene): cell for policy, cell in zip(results.policies, block)}
    rows = [
        [Cell(policy), Cell(column.title, note=column.meaning), *(cells[policy, column.key, scene] for scene in scenes)]
        for policy in results.policies
        for column in columns
    ]
    headings = [Heading("Method", numeric=False), Heading("Metric", numeric=False)]
    headings += [Heading(scene or "Avg.") for scene in scenes]
    caption = f"Means over {results.seeds_text}. “{MISSING}”: no finished run; “{NONE}”: not measured or not defined"
    blocks = [k * len(columns) for k in range(1, len(results.policies))]
    title = f"3D reconstruction and view synthesis, protocol {aspect.title}"
    return Table(aspect.of("quality"), title, headings, rows, caption, blocks=blocks)


@once
def ablation_table(results: Results, aspect: Aspect) -> Table:
    """Return a table in the layout of Table 3: a row per policy, and a column per metric.

    ``aspect`` has the metrics. Values are means over the scenes with 95 % intervals.
    """
    columns = aspect.columns
    by_column = []
    for column in columns:
        found = []
        for policy in results.policies:
            strata = results.strata(policy, column.key)
            found.append(
                _undefined(results, policy, column, None) if strata is None else with_interval(estimate(strata), column)
            )
        by_column.append(ranked(found, column, results.planners))
    ladder = LADDER[0] in results.policies
    rows = [
        [Cell(NAMES.get(policy, policy) if ladder else policy, note=policy), *(cells[k] for cells in by_column)]
        for k, policy in enumerate(results.policies)
    ]
    headings = [Heading("Variant" if ladder else "Policy", numeric=False), *map(Heading.of, columns)]
    if all(len(results.of(policy, scene)) < 2 for policy in results.policies for scene in results.scenes):
        caption = (
            "One run per policy"
            if len(results.scenes) == 1
            else f"Means over {len(results.scenes)} scenes, one run each"
        )
    else:
        caption = (
            f"Means over {pluralised(len(results.scenes), 'scene')} of the means over runs, with 95 % "
            "intervals; no interval if a scene has a single run"
        )
    if len(results.scenes) > 1:
        caption += ". Only policies with a run on every scene have values"
    return Table(aspect.of("variants"), f"All policies, protocol {aspect.title}", headings, rows, caption)


def time_table(results: Results) -> Table:
    """Return a table in the layout of Table 4: wall time in minutes per method and scene, without evaluation."""
    column = Column("seconds", "Time", "min", 2, "lowest")
    row, groups = [Cell("Time (min)")], [("", 1)]
    for scene in results.scenes:
        seconds = [_mean(results, policy, column, scene).value for policy in results.policies]
        minutes = [number(None if s is None else s / 60, column.digits, MISSING) for s in seconds]
        row += ranked(minutes, column, results.planners)
        groups.append((scene, len(results.policies)))
    headings = [Heading("Method", numeric=False)]
    headings += [Heading(policy) for _ in results.scenes for policy in results.policies]
    caption = "Mean wall clock of an episode, without loading and evaluation"
    return Table("time", "Computational efficiency", headings, [row], caption, groups=groups)


def tables_like_the_papers(results: Results) -> list[Table]:
    """Return the tables in the layout of the paper's Tables 1 to 4, for every aspect of the runs."""
    found = [table(results, aspect) for aspect in aspects(results.runs) for table in (quality_table, ablation_table)]
    return [*found, time_table(results)]


def _mean(results: Results, policy: str, column: Column, scene: str | None) -> Cell:
    """Return a cell with a policy's mean of a metric on ``scene``, or over all scenes for None."""
    strata = results.strata(policy, column.key, scene)
    if strata is None:
        return _undefined(results, policy, column, scene)
    return number(float(mean(np.concatenate(strata), [len(values) for values in strata])), column.digits)


def _undefined(results: Results, policy: str, column: Column, scene: str | None) -> Cell:
    """Return the cell of a policy without a value: `MISSING` without a run, else `NONE` with the reason as tooltip."""
    if not all(results.of(policy, own) for own in ([scene] if scene else results.scenes)):
        return Cell(MISSING)
    reasons = [reason for run in results.of(policy, scene) if (reason := reason_of(run, column.key))]
    return Cell(NONE, note=reasons[0] if reasons else "")
