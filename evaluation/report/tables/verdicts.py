"""Build statistical tables: best policies, paired differences, probability of improvement, aggregates, areas, costs."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from activestructure_gym.evaluation.report.charts.convergence import COSTS as AXES
from activestructure_gym.evaluation.report.charts.convergence import areas, measures_of
from activestructure_gym.evaluation.report.results import Results, once
from activestructure_gym.evaluation.report.tables.columns import (
    COSTS,
    MAIN,
    PROGRESS,
    Column,
    is_lower_bound,
    measured,
    quality_columns,
    unreached_levels_text,
)
from activestructure_gym.evaluation.report.tables.layout import (
    MISSING,
    Cell,
    Heading,
    Judgement,
    Table,
    number,
    ranked,
    with_interval,
)
from activestructure_gym.evaluation.statistics import (
    STATISTICS,
    Estimate,
    PairedDifference,
    estimate,
    paired_difference,
    probability_of_improvement,
)

FEW = 6  # with fewer pairs, a two-sided sign test cannot be significant at 5 %: 2 / 2^5 = 6 %, and 2 / 2^6 = 3 %


@dataclass(frozen=True)
class Lead:
    """Hold the best policy in one metric, and its difference to the second-best policy."""

    column: Column  # the metric
    policy: str  # the best policy
    mean: Estimate  # mean of the best policy
    tied: tuple[str, ...] = ()  # policies whose means differ by at most `Column.tie`; then there is no margin
    runner_up: str | None = None  # the second-best policy
    margin: PairedDifference | None = None  # best minus second-best


def leads(results: Results) -> list[Lead]:
    """Return, for each main metric, the planner with the best mean over the scenes.

    Only planners with a run on every scene are compared (`partial` has the others). After a failed run, the best mean
    may be worse than the second-best one in the pairs of both. Then the means over the scenes and seeds that all
    planners have are compared instead.
    """
    found = []
    for column in measured(MAIN, results.runs):
        cells = {
            policy: results.cells(policy, column.key)
            for policy, planner in zip(results.policies, results.planners)
            if planner and results.strata(policy, column.key) is not None
        }
        if not cells:
            continue
        lead = _lead(cells, column)
        shared = set.intersection(*map(set, cells.values()))
        is_worse = lead.margin is not None and lead.margin.difference.value * column.sign < 0
        if is_worse and {scene for scene, _ in shared} == set(results.scenes):
            lead = _lead({policy: {cell: own[cell] for cell in shared} for policy, own in cells.items()}, column)
        found.append(lead)
    return found


def _lead(cells: dict[str, dict[tuple[str, int], float]], column: Column) -> Lead:
    """Return the lead in one metric, whose values are given by policy and by scene and seed."""
    means = {
        policy: estimate([
            np.array([value for (place, _), value in own.items() if place == scene])
            for scene in dict.fromkeys(scene for scene, _ in own)
        ])
        for policy, own in cells.items()
    }  # fmt: skip
    order = sorted(means, key=lambda policy: -column.sign * means[policy].value)
    first, second = order[0], order[1] if len(order) > 1 else None
    tied = tuple(p for p in order[1:] if abs(means[p].value - means[first].value) <= column.tie)
    margin = paired_difference(cells[first], cells[second]) if second is not None and not tied else None
    return Lead(column, first, means[first], tied, second, margin)


def partial(results: Results) -> list[str]:
    """Return the planners without a run on some scene, which are not in `leads`."""
    return [
        policy
        for policy, planner in zip(results.policies, results.planners)
        if planner and not all(results.of(policy, scene) for scene in results.scenes)
    ]


@once
def differences(results: Results, column: Column) -> dict[str, PairedDifference]:
    """Return, by policy, the difference to the baseline in one metric, paired by scene and seed."""
    base = results.baseline
    if base is None:
        return {}
    theirs = results.cells(base, column.key)
    pairs = {
        policy: paired_difference(results.cells(policy, column.key), theirs, tie=column.tie)
        for policy in results.policies
        if policy != base
    }
    return {policy: pair for policy, pair in pairs.items() if pair is not None}


@once
def has_intervals(results: Results) -> bool:
    """Return whether some policy has intervals: it shares at least two seeds with the baseline on each common scene."""
    finished = {policy: {(run.scene, run.job.seed) for run in results.of(policy)} for policy in results.policies}
    theirs = finished.pop(results.baseline or "", set())
    pairs = [Counter(scene for scene, _ in own & theirs) for own in finished.values()]
    return any(shared and min(shared.values()) > 1 for shared in pairs)


def verdict(pair: PairedDifference, column: Column) -> tuple[str, Judgement]:
    """Return a text such as "better (95 %)" and a tone for a paired difference; both are empty without an interval.

    Printed values are compared, so differences below the last printed digit are equal. The interval of very few pairs
    rests on a normal distribution; with fewer than `FEW` pairs, the text states their number and the tone is empty.
    """
    exact = pair.difference
    if exact.low is None or exact.high is None:
        return "", ""
    found = replace(exact, value=_printed(exact.value, column), low=_printed(exact.low, column),
                    high=_printed(exact.high, column))  # fmt: skip
    if found.low == found.high == 0.0:
        return "equal as printed", ""
    if not found.excludes(0.0):
        return "no significant difference", ""
    better = found.value * column.sign > 0
    words = f"{'better' if better else 'worse'} (95 %)"
    if pair.pairs < FEW:
        return f"{words}, {pair.pairs} pairs only", ""
    return words, "good" if better else "bad"


@once
def difference_table(results: Results) -> Table | None:
    """Return the table of paired differences to the baseline, with a row per policy and metric; None without a row.

    A row has the difference with its interval, a verdict, and how many pairs are better, equal and worse.
    """
    rows: list[list[Cell]] = []
    blocks: list[int] = []
    intervals = has_intervals(results)
    for policy in results.policies:
        if policy == results.baseline:
            continue
        own = []
        for column in measured(dict.fromkeys((*MAIN, *quality_columns(results.runs), *PROGRESS)), results.runs):
            pair = differences(results, column).get(policy)
            both = (*results.of(policy), *results.of(results.baseline))
            if pair is None or all(is_lower_bound(run, column.key) for run in both):
                continue
            wins, losses = (pair.higher, pair.lower) if column.sign > 0 else (pair.lower, pair.higher)
            name = Cell(column.title, note=column.meaning)
            row = [Cell(policy), name, with_interval(pair.difference, column, signed=True)]
            row.append(Cell(f"{wins} / {pair.equal} / {losses}", wins / pair.pairs))
            if intervals:
                words, tone = verdict(pair, column)
                row.insert(3, Cell(words or MISSING, tone=tone))
                row.append(number(_improvement(results, policy, results.baseline or "", column), 2, MISSING))
            own.append(row)
        if own and rows:
            blocks.append(len(rows))
        rows += own
    if not rows:
        return None
    headings = [Heading("Policy", numeric=False), Heading("Metric", numeric=False), Heading("Difference")]
    headings.append(
        Heading(
            "better / equal / worse",
            note="pairs of scene and seed; equal: at most half of the last printed digit apart",
        )
    )
    caption = f"Each policy minus {results.baseline}, paired by scene and seed, averaged over the scenes of both"
    if measured(PROGRESS, results.runs):
        caption += ". Frames to N %: a run that did not reach N % counts with its frame budget"
        caption += f". {missing}" if (missing := unreached_levels_text(results.runs)) else ""
    if intervals:
        headings.insert(3, Heading("Verdict", numeric=False))
        headings.append(Heading("P(improvement)"))
        caption += (
            "; 95 % intervals. Better or worse (95 %): the printed interval excludes 0. "
            "Differences below the last printed digit are equal"
        )
    return Table("differences", f"Against {results.baseline}", headings, rows, caption, blocks=blocks)


def improvement_table(results: Results, column: Column) -> Table | None:
    """Return a table of the probabilities that a run of the row's policy is better than a run of the column's policy.

    Return None if fewer than two policies have values of the metric on every scene.
    """
    policies = [policy for policy in results.policies if results.strata(policy, column.key) is not None]
    if len(policies) < 2:
        return None
    rows = []
    for ours in policies:
        row = [Cell(ours)]
        for theirs in policies:
            chance = None if ours == theirs else _improvement(results, ours, theirs, column)
            cell = number(chance, 2, MISSING)
            pair = paired_difference(results.cells(ours, column.key), results.cells(theirs, column.key))
            tone = verdict(pair, column)[1] if pair is not None and ours != theirs else ""
            row.append(Cell(cell.text, cell.value, tone=tone))
        rows.append(row)
    return Table(
        f"improvement_{column.key}",
        f"Probability of improvement in {column.header}",
        [Heading("row better than column", numeric=False), *(Heading(policy) for policy in policies)],
        rows,
        "Chance that a run of the row is better than one of the column; equal runs count half. Mean over scenes; "
        f"coloured if the paired difference is significant and of at least {FEW} pairs",
    )


@once
def aggregate_table(results: Results) -> Table:
    """Return the table of mean, median and interquartile mean of every quality metric, with intervals."""
    rows: list[list[Cell]] = []
    blocks: list[int] = []
    for column in quality_columns(results.runs):
        block = []
        for name, statistic in STATISTICS.items():
            found = []
            for policy in results.policies:
                own = results.strata(policy, column.key)
                found.append(with_interval(None if own is None else estimate(own, statistic), column))
            heading = Cell(column.title, note=column.meaning)
            block.append([heading, Cell(name), *ranked(found, column, results.planners)])
        if rows:
            blocks.append(len(rows))
        rows += block
    headings = [Heading("Metric", numeric=False), Heading("Statistic", numeric=False)]
    headings += [Heading(policy) for policy in results.policies]
    caption = (
        "Mean: mean over scenes of the means over runs. Median: median over scenes of the means over runs; with one "
        "scene, median over its runs. IQM (interquartile mean): mean of the middle half of all runs"
    )
    return Table("aggregates", "Mean, median, interquartile mean", headings, rows, caption, blocks=blocks)


@once
def area_table(results: Results) -> Table:
    """Return the table of areas under the convergence curves: a row per policy, a column per measure and cost."""
    columns = []
    for measure in measures_of(results):
        column = Column.of(measure.metric)
        for cost in AXES:
            strata = [areas(results, policy, cost.key, measure.key) for policy in results.policies]
            found = [with_interval(None if own is None else estimate(own), column) for own in strata]
            columns.append(
                (Heading(f"{column.title}, {cost.key}", note=column.meaning), ranked(found, column, results.planners))
            )
    rows = [[Cell(policy), *(cells[k] for _, cells in columns)] for k, policy in enumerate(results.policies)]
    headings = [Heading("Policy", numeric=False), *(heading for heading, _ in columns)]
    caption = (
        "Area under the curve up to the budget, divided by the budget. For metres and seconds the budget is the lowest "
        "total of any run on the scene"
    )
    return Table("areas", "Area under the curves", headings, rows, caption)


@once
def cost_table(results: Results) -> Table:
    """Return the table of costs with a row per policy: means over all runs, and the sum of collisions."""
    columns = measured(COSTS, results.runs)
    rows = []
    for policy in results.policies:
        row = [Cell(policy)]
        for column in columns:
            cells = results.cells(policy, column.key)
            if column.key == "collisions" and cells:
                total = int(sum(cells.values()))
                row.append(Cell(str(total), total, tone="alarm" if total else "good"))
            else:
                values = np.array(list(cells.values()))
                cell = number(float(values.mean()) if len(values) else None, column.digits, MISSING)
                row.append(cell)
        rows.append(row)
    collisions = "Collisions: sum over all runs of executed steps through the true mesh; it must be 0. "
    caption = (
        f"Means over all runs. {collisions if any(column.key == 'collisions' for column in columns) else ''}"
        "Wall-clock seconds: planning is candidates, paths, features and the policy; mapping is the Gaussian map"
    )
    return Table("costs", "Costs", [Heading("Policy", numeric=False), *map(Heading.of, columns)], rows, caption)


@once
def _improvement(results: Results, ours: str, theirs: str, column: Column) -> float | None:
    """Return the probability that a run of ``ours`` is better than one of ``theirs``, on scenes with runs of both."""
    strata = [
        (mine, other)
        for scene in results.scenes
        if (mine := results.strata(ours, column.key, scene)) and (other := results.strata(theirs, column.key, scene))
    ]
    if not strata:
        return None
    ours_then_theirs = ([column.sign * runs[0] for runs in side] for side in zip(*strata))
    return probability_of_improvement(*ours_then_theirs, tie=column.tie)


def _printed(value: float, column: Column) -> float:
    return round(value, column.digits)
