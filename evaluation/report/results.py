"""Hold the data of a report: the finished runs of one or more directories, the missing runs, and a baseline."""

from __future__ import annotations

import copy
import dataclasses
import functools
import math
import shlex
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar, cast

import numpy as np

from activestructure_gym.errors import InputError, listed, pluralised, unknown_name
from activestructure_gym.evaluation.archive import completion, store
from activestructure_gym.evaluation.archive.comparison import jobs_of, read_record, readable_runs, run_directory
from activestructure_gym.evaluation.archive.jobs import Job, ranked_among, scene_label, scene_labels, titles_of
from activestructure_gym.evaluation.archive.played import is_played
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report.style import COLOURS
from activestructure_gym.evaluation.report.tables.columns import value_of
from activestructure_gym.evaluation.statistics import mean, pooled

P = ParamSpec("P")
T = TypeVar("T")

_ON_A_SCREEN = 7  # largest number of policies next to each other
_DIGITS = 8  # number of digits of a content hash that are shown
_RESULT = "completion_ratio"  # key of the metric by which the runs with images are selected
_RESULT_WITHOUT_TRUTH = "known_m3"
# The default baseline is the first of these policies with a run.
_BASELINES = ("activestructure-a", "pixel_only", "random")


@dataclass(frozen=True)
class Source:
    """Hold a directory from which runs were read, and the jobs that have no result in it."""

    directory: Path
    commands: Sequence[str] = ()  # command lines that began the comparison and added jobs; none for a single run
    workers: int | None = None  # number of parallel jobs
    missing: Mapping[str, str] = dataclasses.field(default_factory=dict)  # reason by title for jobs without a result


@dataclass(frozen=True)
class Results:
    """Hold the finished runs of a report, at most one per scene, policy and seed.

    Of several runs of one scene, policy and seed, the one with the most protocols is kept, of equals the first. In a
    sweep, a policy with other values of the swept fields counts as another policy. Raise `InputError` for no runs, for
    runs of different conditions, and for a baseline without runs.
    """

    runs: Sequence[Run]
    sources: Sequence[Source]
    baseline: str | None = None  # policy to compare the others with; None: the first of `_BASELINES`, else of the runs

    def __post_init__(self) -> None:
        if not self.runs:
            raise InputError("a report needs at least one finished run, got none")
        if self.baseline not in self.policies and (own := [r.policy for r in self.runs if r.planner == self.baseline]):
            object.__setattr__(self, "baseline", own[0])  # of a sweep: the policy with its first values
        if self.baseline is not None and self.baseline not in self.policies:
            raise InputError(
                f"the baseline '{self.baseline}' is not among the policies of these runs: {listed(self.policies)}"
            )
        for name, found in conditions(self.runs).items():
            if len(found) > 1:
                raise InputError(
                    f"these runs were made under different conditions ({name}: {listed(found)}); a report needs "
                    "equal conditions, so write one report for each"
                )
        kept: dict[tuple[str, str, int], Run] = {}
        for run in self.runs:
            other = kept.setdefault((run.scene, run.policy, run.job.seed), run)
            if other is not run and len(run.protocols) > len(other.protocols):
                kept[run.scene, run.policy, run.job.seed] = run
        object.__setattr__(self, "runs", list(kept.values()))
        if self.baseline is None and len(self.policies) > 1:
            usual = [run.policy for name in _BASELINES for run in self.runs if run.planner == name]
            object.__setattr__(self, "baseline", usual[0] if usual else self.policies[0])

    @cached_property
    def policies(self) -> list[str]:
        """Return the policies in the order of the runs."""
        return list(dict.fromkeys(run.policy for run in self.runs))

    @cached_property
    def sweep(self) -> dict[str, list[Any]]:
        """Return the values of each swept field: numbers in ascending order, else in the order of the runs."""
        found: dict[str, list[Any]] = {}
        for run in self.runs:
            for name, value in run.job.swept_values.items():
                if value not in found.setdefault(name, []):
                    found[name].append(value)
        numeric = {name: all(isinstance(value, int | float) for value in values) for name, values in found.items()}
        return {name: sorted(values) if numeric[name] else values for name, values in found.items()}

    @cached_property
    def protocols(self) -> dict[str, Any]:
        """Return the stored content of each protocol by name, from the first run that it has measured."""
        found: dict[str, Any] = {}
        for run in self.runs:
            found = {**run.protocols, **found}
        return found

    def each(self, text: Callable[[Mapping[str, Any]], str]) -> str:
        """Return a text on the configuration of the runs; different texts, as in a sweep, are joined by "or"."""
        return " or ".join(dict.fromkeys(text(run.config["configuration"]) for run in self.runs))

    @cached_property
    def palette(self) -> list[str]:
        """Return the policies in the order in which they get colours.

        This is the order of the runs if there are enough colours for all policies. Otherwise the baseline is first,
        then the policies with the highest mean completion ratio. Policies without a run on every scene are last.
        """
        if len(self.policies) <= len(COLOURS):
            return self.policies
        means = {
            policy: float(mean(*pooled(strata)))
            for policy in self.policies
            if (strata := self.strata(policy, "completion_ratio")) is not None
        }
        return sorted(self.policies, key=lambda name: (name != self.baseline, -means.get(name, -math.inf)))

    @cached_property
    def planners(self) -> list[bool]:
        """Return, in the order of ``policies``, whether each policy is ranked.

        References are not ranked; given trajectories are not ranked if there are planners.
        """
        ranked = ranked_among({run.job.policy for run in self.runs})
        names = {run.policy for run in self.runs if run.job.policy in ranked}
        return [policy in names for policy in self.policies]

    @cached_property
    def scenes(self) -> list[str]:
        """Return the scenes in the order of the runs."""
        return list(dict.fromkeys(run.scene for run in self.runs))

    @cached_property
    def seeds(self) -> list[int]:
        """Return the seeds in ascending order."""
        return sorted({run.job.seed for run in self.runs})

    @cached_property
    def seeds_text(self) -> str:
        """Return how many seeds a policy has on a scene, such as "2 seeds" or "up to 3 seeds"."""
        counts = {len(self.of(policy, scene)) for policy in self.policies for scene in self.scenes} - {0}
        return ("up to " if len(counts) > 1 else "") + pluralised(max(counts, default=0), "seed")

    @cached_property
    def missing(self) -> dict[str, str]:
        """Return the reason why a requested job has no result, by the title of the job."""
        return {name: why for source in self.sources for name, why in source.missing.items()}

    @cached_property
    def _by_cell(self) -> dict[tuple[str | None, str | None], list[Run]]:
        """Return the runs by policy and scene; None selects all policies or scenes."""
        found: dict[tuple[str | None, str | None], list[Run]] = {}
        for run in self.runs:
            for cell in ((None, None), (run.policy, None), (None, run.scene), (run.policy, run.scene)):
                found.setdefault(cell, []).append(run)
        return found

    @cached_property
    def found(self) -> dict[Hashable, Any]:
        """Return the dictionary in which `once` caches values."""
        return {}

    def of(self, policy: str | None = None, scene: str | None = None) -> list[Run]:
        """Return the runs of ``policy`` on ``scene``; None selects all policies or all scenes."""
        return list(self._by_cell.get((policy, scene), ()))

    def cells(self, policy: str, key: str, scene: str | None = None) -> dict[tuple[str, int], float]:
        """Return the defined values of the metric ``key`` in a policy's runs, by (scene, seed); None: on all scenes."""
        values = {(run.scene, run.job.seed): value_of(run, key) for run in self.of(policy, scene)}
        return {cell: float(value) for cell, value in values.items() if value is not None}

    def strata(self, policy: str, key: str, scene: str | None = None) -> list[np.ndarray] | None:
        """Return a policy's values of the metric ``key``: one array per scene, or only that of ``scene``.

        Return None if a scene has no value.
        """
        cells = self.cells(policy, key, scene)
        found = [
            np.array([value for (own, _), value in cells.items() if own == name])
            for name in ([scene] if scene else self.scenes)
        ]
        return found if all(len(values) for values in found) else None

    def shown(self, scene: str) -> list[Run]:
        """Return the runs on ``scene`` whose images are compared; they have one seed, and so one start pose.

        Candidates are the seeds with the most finished policies. Of these, the seed with the median completion ratio is
        taken, where the ratio is averaged over the policies. For an even number of seeds, it is the lower of the middle
        two. Runs without ground truth are compared by their known volume instead.
        """
        by_seed: dict[int, list[Run]] = {}
        for policy in self.policies:
            for run in self.of(policy, scene):
                by_seed.setdefault(run.job.seed, []).append(run)
        most = max(map(len, by_seed.values()), default=0)
        means = [
            (float(np.mean([_result(run) for run in runs])), seed)
            for seed, runs in by_seed.items()
            if len(runs) == most
        ]
        return by_seed[sorted(means)[(len(means) - 1) // 2][1]] if means else []

    def foremost(self, scene: str) -> list[Run]:
        """Return at most seven of the `shown` runs: the baseline, and the runs with the best result."""
        runs = self.shown(scene)
        ranks = sorted(runs, key=lambda run: (run.policy != self.baseline, -_result(run)))
        kept = {run.policy for run in ranks[:_ON_A_SCREEN]}
        return [run for run in runs if run.policy in kept]


def _result(run: Run) -> float:
    """Return the completion ratio of a run, or its known volume if it has no ground truth."""
    return value_of(run, _RESULT if run.has_truth else _RESULT_WITHOUT_TRUTH) or 0.0


def opened(runs: Sequence[Run]) -> list[Run]:
    """Return copies of runs from which images can be read; the images are freed together with the copies.

    Raise `InputError` if the runs have not stored the same views.
    """
    copies = [copy.copy(run) for run in runs]
    if len(copies) > 1:
        for run in (run for run in copies if not run.has_truth):  # keyframes of several runs share only the first view
            first = {name: run.pictures[name][:1] for name in ("rendered", "true", "psnr")}
            run.__dict__["pictures"] = {**run.pictures, **first}
    for run in copies[1:]:
        if run.pictures["true"].shape != copies[0].pictures["true"].shape:
            raise InputError(
                f"'{run.directory}' and '{copies[0].directory}' have not stored the same held-out views of "
                f"{run.scene}: report them separately, or repeat one of them"
            )
    return copies


def once(function: Callable[Concatenate[Results, P], T]) -> Callable[Concatenate[Results, P], T]:
    """Decorate a function of `Results` and hashable arguments, such that its values are cached in the results."""

    @functools.wraps(function)
    def cached(results: Results, *args: P.args, **kwargs: P.kwargs) -> T:
        key = function.__module__, function.__qualname__, args, tuple(sorted(kwargs.items()))
        if key not in results.found:
            results.found[key] = function(results, *args, **kwargs)
        return cast(T, results.found[key])

    return cached


def conditions(runs: Sequence[Run]) -> dict[str, list[str]]:
    """Return the different values of each condition that compared runs must share, by the name of the condition.

    If only some runs have a condition, such as an override, the value of the other runs is "not given".
    """
    found: dict[str, dict[str, None]] = {}
    given = [_given_conditions(run) for run in runs]
    names = list(dict.fromkeys(name for flat in given for name in flat))
    for run, flat in zip(runs, given):
        for name in names:
            found.setdefault(name, {})[flat.get(name, "not given")] = None
        found.setdefault(f"start_pose in {run.scene}", {})[str(run.job.conditions.start_pose)] = None
        if run.job.scene_hash:  # the file of a scene may have changed
            found.setdefault(f"content of {run.scene}", {})[run.job.scene_hash[:_DIGITS]] = None
    return {name: list(values) for name, values in found.items()}


def _given_conditions(run: Run) -> dict[str, str]:
    job = run.job.as_dict()
    flat = {name: job[name] for name in ("preset", "frame_budget")} | {"setup": run.job.conditions.setup}
    flat |= {"sweep": ", ".join(run.job.swept) or "none"}
    flat |= {f"set {name}": value for name, value in job["overrides"].items()}
    flat |= {f"protocol {name}": value for name, value in job["protocol"].items()}
    return {name: str(value) for name, value in flat.items()}


def gather(
    directories: Sequence[Path], baseline: str | None = None, labels: Mapping[str, str] | None = None
) -> Results:
    """Read the runs in directories of comparisons and of single runs, in the given order.

    ``baseline`` is as in `Results`. ``labels`` maps names of policies and scenes to the names that the report shows;
    ``baseline`` is either. If a job is in two directories, the first run is used. A damaged run is listed as
    missing, with the reason. Raise `InputError` for other directories, and if there is no run.
    """
    runs: dict[str, Run] = {}
    sources, reasons, asked_for = list[Source](), list[str](), list[Job]()
    records: dict[int, tuple[dict[str, Any], dict[str, str]]] = {}  # record and damage by index of the source
    for directory in directories:
        if (directory / store.COMPARISON).is_file():
            record = dict(read_record(directory) or {"jobs": {}})
            jobs = jobs_of(record, directory)
            found, damaged = readable_runs(directory, jobs)
            asked_for += jobs
            records[len(sources)] = record, damaged
            sources.append(Source(directory))
        elif (directory / completion.DONE).is_file():
            found, damaged = [], {}
            try:
                run = store.read_run(directory)
                store.read_shown(copy.copy(run))
                found.append(run)
            except InputError as error:
                damaged[str(directory)] = str(error)
            sources.append(Source(directory, missing=damaged))
        else:
            raise store.without_runs(directory)
        reasons += damaged.values()
        for run in found:
            runs.setdefault(run.job.hash, run)
    titles = titles_of(asked_for)
    for index, (record, damaged) in records.items():  # a job that failed in one directory may be finished in another
        sources[index] = source_of(sources[index].directory, record, list(runs.values()), damaged, titles)
    if not runs and reasons:
        more = f"; and {len(reasons) - 1} more" if reasons[1:] else ""
        raise InputError(f"no run can be reported: {reasons[0]}{more}")
    if not runs:
        asked = sum(len(source.missing) for source in sources)
        resume = "; ".join(f"asg compare --out {shlex.quote(str(source.directory))} --resume" for source in sources)
        raise InputError(
            f"there is no finished run in {listed(directories)}"
            + (f": {pluralised(asked, 'run')} asked for and none at its end, go on with {resume}" if asked else "")
        )
    # Scene files with equal name and content are one scene, even if their paths differ.
    first: dict[tuple[str, str], str] = {}
    specs = [
        first.setdefault((job.scene_hash or job.scene, scene_label(job.scene)), job.scene)
        for job in (run.job for run in runs.values())
    ]
    scenes = scene_labels({spec: run.job.scene_hash for spec, run in zip(specs, runs.values())})
    named = [dataclasses.replace(run, scene=scenes[spec]) for spec, run in zip(specs, runs.values())]
    given = labels or {}
    return Results(labelled(named, given), sources, None if baseline is None else given.get(baseline, baseline))


def labelled(runs: Sequence[Run], labels: Mapping[str, str]) -> list[Run]:
    """Return the runs with the ``labels`` of policies and scenes in place of their names.

    In a sweep, the label of a policy is followed by the swept values, which may have a label of their own. Raise
    `InputError` for a name that no run has, and for a label that two names would share.
    """
    policies = dict.fromkeys(name for run in runs for name in (run.policy, run.planner))
    names = [*policies, *dict.fromkeys(run.scene for run in runs)]
    if unknown := [name for name in labels if name not in names]:
        raise unknown_name("policy or scene", unknown[0], names)
    shown = [labels.get(name, name) for name in names]
    if double := [text for text in shown if shown.count(text) > 1]:
        raise InputError(f"two names would have the label '{double[0]}': choose different labels")
    found = []
    for run in runs:
        planner = labels.get(run.planner, run.planner)
        policy = labels.get(run.policy, planner + run.job.swept_text)
        found.append(dataclasses.replace(run, scene=labels.get(run.scene, run.scene)))
        found[-1].__dict__.update(policy=policy, planner=planner)  # replaces the cached names
    return found


def source_of(
    directory: Path,
    record: Mapping[str, Any],
    runs: Sequence[Run],
    damaged: Mapping[str, str] | None = None,
    titles: Mapping[str, str] | None = None,
) -> Source:
    """Return the `Source` of a comparison in ``directory``, with the jobs that have no run among ``runs``.

    ``record`` is the content of ``compare.json``. By the name of the job, ``damaged`` has the reason for each damaged
    run, and ``titles`` the titles; None derives the titles from the record.
    """
    finished = {run.job.hash for run in runs}
    jobs = [Job.from_dict(content) for content in (record.get("jobs") or {}).values()]
    titles = titles_of(jobs) if titles is None else titles
    failed, missing = record.get("failed") or {}, dict[str, str]()
    for job in jobs:
        if job.hash not in finished:  # another process may have finished a job that failed
            reason = (damaged or {}).get(job.name) or failed.get(job.name) or "not finished"
            kept = "; its episode is complete, but not measured yet" * is_played(run_directory(directory, job))
            missing[titles[job.name]] = reason + kept
    commands = [command for command in (record.get("command", ""), *record.get("resumed", ())) if command]
    return Source(directory, commands, record.get("workers"), missing)
