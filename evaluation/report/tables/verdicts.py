"""Tables of the statistics: leaders, paired differences, probability of improvement, areas, costs."""

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
    exceeded,
    measured,
    quality_columns,
    unreached,
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

_FEW = 6  # pairs; of fewer not even all agreeing passes a two-sided sign test at 5 % (2 / 2^6 = 3 %)


@dataclass(frozen=True)
class Lead:
    """The leading policy in one metric, and its difference to the next."""

    column: Column
    policy: str
    mean: Estimate
    level: tuple[str, ...] = ()  # policies whose mean is printed alike; then nobody leads
    runner_up: str | None = None
    ahead: PairedDifference | None = None


def leads(results: Results) -> list[Lead]:
    """The best mean of every main metric, among the policies that finished on every scene; a reference leads nobody."""
    found = []
    for column in measured(MAIN, results.runs):
        means = {
            policy: estimate(own)
            for policy, planner in zip(results.policies, results.planners)
            if planner and (own := results.strata(policy, column.key)) is not None
        }
        if not means:
            continue
        order = sorted(means, key=lambda policy: -column.sign * means[policy].value)
        first, second = order[0], order[1] if len(order) > 1 else None
        level = tuple(p for p in order[1:] if _printed(means[p].value, column) == _printed(means[first].value, column))
        ahead = None
        if second is not None and not level:
            ahead = paired_difference(results.cells(first, column.key), results.cells(second, column.key))
        found.append(Lead(column, first, means[first], level, second, ahead))
    return found


@once
def differences(results: Results, column: Column) -> dict[str, PairedDifference]:
    """Every policy against the baseline in one metric, paired by scene and seed."""
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
def can_tell(results: Results) -> bool:
    """Whether intervals exist: a policy shares two seeds or more with the baseline wherever both ran."""
    finished = {policy: {(run.scene, run.job.seed) for run in results.of(policy)} for policy in results.policies}
    theirs = finished.pop(results.baseline or "", set())
    pairs = [Counter(scene for scene, _ in own & theirs) for own in finished.values()]
    return any(shared and min(shared.values()) > 1 for shared in pairs)


def verdict(pair: PairedDifference, column: Column) -> tuple[str, Judgement]:
    """Words and tone for a paired difference: its interval's side of 0; nothing without an interval.

    The numbers are judged as they are printed: what is smaller than the last digit is neither better nor worse. A
    resampled interval of very few pairs excludes 0 as soon as all of them agree, so below `_FEW` that is said.
    """
    exact = pair.difference
    if exact.low is None or exact.high is None:
        return "", ""
    found = replace(exact, value=_printed(exact.value, column), low=_printed(exact.low, column),
                    high=_printed(exact.high, column))  # fmt: skip
    if found.low == found.high == 0.0:
        return "equal as printed", ""
    if not found.excludes(0.0):
        return "0 not excluded", ""
    better = found.value * column.sign > 0
    words = f"0 excluded: {'better' if better else 'worse'}"
    if pair.pairs < _FEW:
        return f"{words}, {pair.pairs} pairs only", ""
    return words, "good" if better else "bad"


@once
def difference_table(results: Results) -> Table | None:
    """A row per policy and metric: the paired difference to the baseline with its interval, and what it excludes."""
    rows: list[list[Cell]] = []
    blocks: list[int] = []
    chance_known = can_tell(results)
    for policy in results.policies:
        if policy == results.baseline:
            continue
        own = []
        for column in measured(dict.fromkeys((*MAIN, *quality_columns(results.runs), *PROGRESS)), results.runs):
            pair = differences(results, column).get(policy)
            both = (*results.of(policy), *results.of(results.baseline))
            if pair is None or all(exceeded(run, column.key) for run in both):
                continue
            wins, losses = (pair.higher, pair.lower) if column.sign > 0 else (pair.lower, pair.higher)
            row = [Cell(policy), Cell(column.title), with_interval(pair.difference, column.digits, signed=True)]
            row.append(Cell(f"{wins} / {pair.equal} / {losses}", wins / pair.pairs))
            if chance_known:
                words, tone = verdict(pair, column)
                row.insert(3, Cell(words or MISSING, tone=tone))
                row.append(with_interval(_improvement(results, policy, results.baseline or "", column), 2))
            own.append(row)
        if own and rows:
            blocks.append(len(rows))
        rows += own
    if not rows:
        return None
    headings = [Heading("Policy", numeric=False), Heading("Metric", numeric=False), Heading("Difference")]
    headings.append(Heading("better / equal / worse", note="pairs of scene and seed; equal: as printed"))
    caption = f"Each policy minus {results.baseline}, paired by scene and seed, averaged over the scenes"
    if measured(PROGRESS, results.runs):
        caption += "; frames to a share of the surface are the budget where it was not reached"
        caption += f". {missing}" if (missing := unreached(results.runs)) else ""
    if chance_known:
        headings.insert(3, Heading("Verdict", numeric=False))
        headings.append(Heading("P(improvement)"))
        caption += (
            "; 95 % stratified bootstrap intervals. Verdicts are about the numbers as printed: what is smaller than "
            "the last digit is equal"
        )
    return Table("differences", f"Against {results.baseline}", headings, rows, caption, blocks=blocks)


def improvement_table(results: Results, column: Column) -> Table | None:
    """Every policy against every other: the probability that a run of the row is better than one of the column."""
    policies = [policy for policy in results.policies if results.strata(policy, column.key) is not None]
    if len(policies) < 2:
        return None
    rows = []
    for ours in policies:
        row = [Cell(ours)]
        for theirs in policies:
            chance = None if ours == theirs else _improvement(results, ours, theirs, column)
            cell = with_interval(chance, 2)
            tone: Judgement = ""
            if chance is not None and chance.excludes(0.5):
                tone = "good" if chance.value > 0.5 else "bad"
            row.append(Cell(cell.text, cell.value, tone=tone))
        rows.append(row)
    return Table(
        f"improvement_{column.key}",
        f"Probability of improvement in {column.header}",
        [Heading("row better than column", numeric=False), *(Heading(policy) for policy in policies)],
        rows,
        "P(X > Y) + P(X = Y) / 2 within a scene, averaged over the scenes; coloured where the 95 % interval excludes "
        "1/2",
    )


@once
def aggregate_table(results: Results) -> Table:
    """Mean, median and interquartile mean of every metric, with intervals."""
    rows: list[list[Cell]] = []
    blocks: list[int] = []
    for column in quality_columns(results.runs):
        block = []
        for name, statistic in STATISTICS.items():
            found = []
            for policy in results.policies:
                own = results.strata(policy, column.key)
                found.append(with_interval(None if own is None else estimate(own, statistic), column.digits))
            block.append([Cell(column.title), Cell(name), *ranked(found, column, results.planners)])
        if rows:
            blocks.append(len(rows))
        rows += block
    headings = [Heading("Metric", numeric=False), Heading("Statistic", numeric=False)]
    headings += [Heading(policy) for policy in results.policies]
    caption = (
        "Mean: over scenes of the mean over runs. Median: over scenes of the mean over runs (with one scene, over its "
        "runs). IQM: mean of the middle half of all runs"
    )
    return Table("aggregates", "Mean, median, interquartile mean", headings, rows, caption, blocks=blocks)


@once
def area_table(results: Results) -> Table:
    """Area under the convergence curves, normalised by the budget, for every measure and cost."""
    columns = []
    for measure in measures_of(results):
        column = Column.of(measure.metric)
        for cost in AXES:
            strata = [areas(results, policy, cost.key, measure.key) for policy in results.policies]
            found = [with_interval(None if own is None else estimate(own), column.digits) for own in strata]
            columns.append((Heading(f"{column.title}, {cost.key}"), ranked(found, column, results.planners)))
    rows = [[Cell(policy), *(cells[k] for _, cells in columns)] for k, policy in enumerate(results.policies)]
    headings = [Heading("Policy", numeric=False), *(heading for heading, _ in columns)]
    caption = (
        "Mean height of the curve up to the budget: the frame budget; for metres and seconds the least that any run on "
        "the scene spent, so that nothing is extrapolated"
    )
    return Table("areas", "Area under the curves", headings, rows, caption)


@once
def cost_table(results: Results) -> Table:
    """Costs of the episodes, planning and mapping apart; a collision is marked as an alarm."""
    columns = measured(COSTS, results.runs)
    rows = []
    for policy in results.policies:
        row = [Cell(policy)]
        for column in columns:
            cells = results.cells(policy, column.key)
            if column.key == "collisions":
                total = int(sum(cells.values()))
                row.append(Cell(str(total), total, tone="alarm" if total else "good"))
            else:
                values = np.array(list(cells.values()))
                cell = number(float(values.mean()) if len(values) else None, column.digits, MISSING)
                row.append(cell)
        rows.append(row)
    caption = (
        "Means over all runs; collisions: executed steps through the true mesh, in all runs together (must be 0). "
        "Seconds of wall clock: planning = candidates, paths, features and the policy; mapping = the Gaussian map"
    )
    return Table("costs", "Costs", [Heading("Policy", numeric=False), *map(Heading.of, columns)], rows, caption)


@once
def _improvement(results: Results, ours: str, theirs: str, column: Column) -> Estimate | None:
    """Over the scenes that both finished."""
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
