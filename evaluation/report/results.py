"""The data of a report: finished runs from one or more directories, missing ones, and a baseline."""

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

from activestructure_gym.errors import InputError, listed, pluralised
from activestructure_gym.evaluation.archive import store
from activestructure_gym.evaluation.archive.comparison import jobs_of, read_record, readable_runs, run_directory
from activestructure_gym.evaluation.archive.jobs import Job, ranked_among, scene_label, scene_labels
from activestructure_gym.evaluation.archive.played import is_played
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report.style import COLOURS
from activestructure_gym.evaluation.report.tables.columns import value_of
from activestructure_gym.evaluation.statistics import mean, pooled

P = ParamSpec("P")
T = TypeVar("T")

_ON_A_SCREEN = 7  # policies side by side
# Whom the others are measured against if nobody is named: the first of these that took part.
_DIGITS = 8  # of a content hash, to tell two apart
_BASELINES = ("activestructure-a", "pixel_only", "random")


@dataclass(frozen=True)
class Source:
    """A directory that runs were read from."""

    directory: Path
    command: str = ""  # empty for a single run's directory
    workers: int | None = None
    missing: Mapping[str, str] = dataclasses.field(default_factory=dict)  # jobs without a result, and why


@dataclass(frozen=True)
class Results:
    """Finished runs; every cell of scene, policy and seed at most once."""

    runs: Sequence[Run]
    sources: Sequence[Source]
    baseline: str | None = None  # a policy; None: chosen by `_BASELINES`

    def __post_init__(self) -> None:
        if not self.runs:
            raise InputError("a report needs at least one finished run, got none")
        if self.baseline is not None and self.baseline not in self.policies:
            raise InputError(
                f"the baseline '{self.baseline}' is not among the policies of these runs: {listed(self.policies)}"
            )
        for name, found in conditions(self.runs).items():
            if len(found) > 1:
                raise InputError(
                    f"these runs were made under different conditions ({name}: {listed(found)}); a report compares "
                    "like with like, so make one for each"
                )
        if self.baseline is None and len(self.policies) > 1:
            usual = [name for name in _BASELINES if name in self.policies]
            object.__setattr__(self, "baseline", usual[0] if usual else self.policies[0])

    @cached_property
    def policies(self) -> list[str]:
        """Policies, in the order of the runs."""
        return list(dict.fromkeys(run.policy for run in self.runs))

    @cached_property
    def palette(self) -> list[str]:
        """Policies in the order of their colours: that of the runs; where colours do not suffice, the foremost first.

        Those are the baseline and those with the highest mean C.R. of the policies that finished on every scene.
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
        """Of every policy whether it has a rank: a reference has none, nor has a trajectory beside planners."""
        ranked = ranked_among({run.job.policy for run in self.runs})
        names = {run.policy for run in self.runs if run.job.policy in ranked}
        return [policy in names for policy in self.policies]

    @cached_property
    def scenes(self) -> list[str]:
        """Scenes, in the order of the runs."""
        return list(dict.fromkeys(run.scene for run in self.runs))

    @cached_property
    def seeds(self) -> list[int]:
        """Seeds, ascending."""
        return sorted({run.job.seed for run in self.runs})

    @cached_property
    def missing(self) -> dict[str, str]:
        """Jobs that were asked for and have no result, each with the reason."""
        return {name: why for source in self.sources for name, why in source.missing.items()}

    @cached_property
    def _by_cell(self) -> dict[tuple[str | None, str | None], list[Run]]:
        """The runs by policy and scene; None stands for all of them."""
        found: dict[tuple[str | None, str | None], list[Run]] = {}
        for run in self.runs:
            for cell in ((None, None), (run.policy, None), (None, run.scene), (run.policy, run.scene)):
                found.setdefault(cell, []).append(run)
        return found

    @cached_property
    def found(self) -> dict[Hashable, Any]:
        """What functions under `once` have found in these results."""
        return {}

    def of(self, policy: str | None = None, scene: str | None = None) -> list[Run]:
        """The runs of a policy, of a scene, or of both."""
        return list(self._by_cell.get((policy, scene), ()))

    def cells(self, policy: str, key: str, scene: str | None = None) -> dict[tuple[str, int], float]:
        """A policy's numbers by scene and seed, where they are defined."""
        values = {(run.scene, run.job.seed): value_of(run, key) for run in self.of(policy, scene)}
        return {cell: float(value) for cell, value in values.items() if value is not None}

    def strata(self, policy: str, key: str, scene: str | None = None) -> list[np.ndarray] | None:
        """A policy's numbers, scene by scene; None if a scene of the report has none."""
        cells = self.cells(policy, key, scene)
        found = [
            np.array([value for (own, _), value in cells.items() if own == name])
            for name in ([scene] if scene else self.scenes)
        ]
        return found if all(len(values) for values in found) else None

    def shown(self, scene: str, key: str = "completion_ratio") -> list[Run]:
        """The runs on a scene whose pictures stand side by side: of one seed, so that all began at the same place.

        Of the seeds that most policies finished it is the one with the median result, averaged over the policies; of
        an even number the lower of the middle two.
        """
        by_seed: dict[int, list[Run]] = {}
        for policy in self.policies:
            for run in self.of(policy, scene):
                by_seed.setdefault(run.job.seed, []).append(run)
        most = max(map(len, by_seed.values()), default=0)
        means = [
            (float(np.mean([value_of(run, key) or 0.0 for run in runs])), seed)
            for seed, runs in by_seed.items()
            if len(runs) == most
        ]
        return by_seed[sorted(means)[(len(means) - 1) // 2][1]] if means else []

    def foremost(self, scene: str, key: str = "completion_ratio") -> list[Run]:
        """As many of the shown runs as fit on a screen: those with the best result, the baseline in any case."""
        runs = self.shown(scene)
        ranks = sorted(runs, key=lambda run: (run.policy != self.baseline, -(value_of(run, key) or 0.0)))
        kept = {run.policy for run in ranks[:_ON_A_SCREEN]}
        return [run for run in runs if run.policy in kept]


def opened(runs: Sequence[Run]) -> list[Run]:
    """The same runs for a look at their pictures: arrays that are read for it go when these runs go.

    Raises `InputError` where runs of one scene have not kept the same views.
    """
    copies = [copy.copy(run) for run in runs]
    for run in copies[1:]:
        if run.pictures["true"].shape != copies[0].pictures["true"].shape:
            raise InputError(
                f"'{run.directory}' and '{copies[0].directory}' have not kept the same held-out views of "
                f"{run.scene}: report them apart, or make one of them again"
            )
    return copies


def once(function: Callable[Concatenate[Results, P], T]) -> Callable[Concatenate[Results, P], T]:
    """A function of results and of what can be hashed, which works once for each: page, files and summary ask alike."""

    @functools.wraps(function)
    def asked(results: Results, *args: P.args, **kwargs: P.kwargs) -> T:
        key = function.__module__, function.__qualname__, args, tuple(sorted(kwargs.items()))
        if key not in results.found:
            results.found[key] = function(results, *args, **kwargs)
        return cast(T, results.found[key])

    return asked


def conditions(runs: Sequence[Run]) -> dict[str, list[str]]:
    """Values of every condition that compared runs must share, as found in the runs.

    What only some of them were told, as a changed field of the preset, the others have as ``not given``.
    """
    found: dict[str, dict[str, None]] = {}
    told = [_told(run) for run in runs]
    names = list(dict.fromkeys(name for flat in told for name in flat))
    for run, flat in zip(runs, told):
        for name in names:
            found.setdefault(name, {})[flat.get(name, "not given")] = None
        found.setdefault(f"start_pose in {run.scene}", {})[str(run.job.conditions.start_pose)] = None
        if run.job.scene_hash:  # one name, as of a file that was changed
            found.setdefault(f"content of {run.scene}", {})[run.job.scene_hash[:_DIGITS]] = None
    return {name: list(values) for name, values in found.items()}


def _told(run: Run) -> dict[str, str]:
    job = run.job.as_dict()
    flat = {name: job[name] for name in ("preset", "frame_budget")} | {"setup": run.job.conditions.setup}
    flat |= {f"set {name}": value for name, value in job["overrides"].items()}
    flat |= {f"protocol {name}": value for name, value in job["protocol"].items()}
    return {name: str(value) for name, value in flat.items()}


def gather(directories: Sequence[Path], baseline: str | None = None) -> Results:
    """The runs of comparisons' directories and of single runs' directories, in the order given.

    A job that is in two of them counts once. A damaged run is left out, and is among the missing with its damage.
    Raises `InputError` for a directory that is neither, and where no run is left.
    """
    runs: dict[str, Run] = {}
    sources, reasons = list[Source](), list[str]()
    for directory in directories:
        if (directory / store.COMPARISON).is_file():
            record = read_record(directory) or {"jobs": {}}
            found, damaged = readable_runs(directory, jobs_of(record, directory))
            sources.append(source_of(directory, record, found, damaged))
        elif (directory / store.DONE).is_file():
            found, damaged = [], {}
            try:
                run = store.read_run(directory)
                store.read_shown(copy.copy(run))
                found.append(run)
            except InputError as error:
                damaged[str(directory)] = str(error)
            sources.append(Source(directory, missing=damaged))
        else:
            raise InputError(f"'{directory}' is neither a comparison ({store.COMPARISON}) nor a finished run")
        reasons += damaged.values()
        for run in found:
            runs.setdefault(run.job.hash, run)
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
    # One content under one file's name is one scene, wherever each machine has it.
    first: dict[tuple[str, str], str] = {}
    specs = [
        first.setdefault((job.scene_hash or job.scene, scene_label(job.scene)), job.scene)
        for job in (run.job for run in runs.values())
    ]
    labels = scene_labels({spec: run.job.scene_hash for spec, run in zip(specs, runs.values())})
    named = [dataclasses.replace(run, scene=labels[spec]) for spec, run in zip(specs, runs.values())]
    return Results(named, sources, baseline)


def source_of(
    directory: Path, record: Mapping[str, Any], runs: Sequence[Run], damaged: Mapping[str, str] | None = None
) -> Source:
    """A comparison as a source: what of its record (``compare.json``) has no run is missing, or ``damaged``."""
    finished = {run.job.hash: run.job.title for run in runs}
    said = record.get("failed") or {}
    missing = {title: why for title, why in said.items() if title not in finished.values()}  # others finished it later
    for content in (record.get("jobs") or {}).values():
        job = Job.from_dict(content)
        if job.hash not in finished:
            reasons = ((damaged or {}).get(job.title), said.get(job.title))
            kept = "; its episode was played and is kept, to be measured" * is_played(run_directory(directory, job))
            missing[job.title] = next(filter(None, reasons), "not run to its end") + kept
    return Source(directory, record.get("command", ""), record.get("workers"), missing)
