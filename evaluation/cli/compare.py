"""Define ``asg compare``, which runs policies on scenes and prints a table."""

from __future__ import annotations

import dataclasses
import shlex
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich.console import Console

from activestructure_gym.errors import InputError, listed, pluralised
from activestructure_gym.evaluation.cli.closing import print_end
from activestructure_gym.evaluation.cli.conditions import ConditionOptions, RunOptions
from activestructure_gym.evaluation.cli.fields import NoNames, Switch, Text, Words, option
from activestructure_gym.evaluation.cli.options import (
    parse_seeds,
    parse_sweep,
    split_list,
    split_policies,
    split_scenes,
    start_of,
    use_lpips_weights,
    use_trust,
)
from activestructure_gym.evaluation.cli.output import make_console, working
from activestructure_gym.policies.native_settings import Setup
from activestructure_gym.specs import Spec
from activestructure_gym.streams import complain, escape

if TYPE_CHECKING:
    from activestructure_gym.evaluation.archive.jobs import Job
    from activestructure_gym.evaluation.running.comparison import Comparison
    from activestructure_gym.evaluation.running.engines import Limits
    from activestructure_gym.evaluation.running.sharding import Shard


@dataclass(frozen=True)
class GridOptions:
    """Hold the options that define the runs of a comparison.

    If none is given, a resumed comparison has the runs of its record.
    """

    scenes: Annotated[tuple[str, ...], option("SCENE [SCENE ...]", "(default: room)")] = ()
    """Explore these scenes, separated by commas or spaces: names (see `asg list scenes`), files, folders."""
    policies: Annotated[Words, option("NAME [NAME ...]", "(default: random activestructure)")] = None
    (
        "Compare these policies: names (see `asg list policies`) with options after a question mark "
        "(active_gs?travel=shared), package.module:Class, `ladder` (the paper's variants A to E), or `all`."
    )
    mappers: NoNames = ()
    (
        "Map recorded trajectories with each of these mappers: default, splatam, monogs, gaussian_slam, co_slam. Name "
        "the trajectories in --policies: trajectory:FILE, trajectory:sweep or trajectory:passive."
    )
    seeds: Annotated[Words, option("N [N ...]", "(default: 0)")] = None
    """Use these whole numbers as seeds; equal seeds start at the same pose, so that policies are compared in pairs."""
    references: NoNames = ()
    (
        "Add references with ground truth: oracle takes the path with the most new surface per frame; oracle-quality "
        "does so in the first half, then takes the path that raises PSNR most per frame."
    )
    sweep: Annotated[tuple[str, ...], option("FIELD=A,B [FIELD=A,B ...]", "")] = ()
    (
        "Run every policy with each of these values of a configuration field, e.g. mapper.seed_spacing=0.06,0.12; "
        "several fields give all combinations."
    )


@dataclass(frozen=True)
class Compare(RunOptions, ConditionOptions, GridOptions):
    """Run policies on scenes under one budget.

    The result is a table and a report page with curves and pictures.
    Without any option: `random` against `activestructure` in a furnished room, in about a minute.
    """

    setup: Annotated[Setup | None, option("{shared,native}", "(default: shared)")] = None
    (
        "Give all policies the same candidates, keyframe schedule and mapper (shared), or each policy its own with "
        "preset full (native)."
    )
    start: Annotated[str | None, option("X,Y,Z,YAW", "")] = None
    (
        "Start every episode at this pose in metres and degrees, such as --start=-1,2,1.4,90; `published` is the start "
        "of the papers in Replica and Matterport3D."
    )
    shard: Annotated[str | None, option("I/N", "")] = None
    (
        "Run part I of N of the comparison, on one of N machines. When all parts are done, `asg compare --resume "
        "--out` writes the report."
    )
    timeout_min: float = 0.0
    """Stop a run after this number of minutes and try it again; 0 is no limit."""
    retries: int = 1
    """Try a run again this many times if it was killed or timed out."""
    replay: Switch = False
    """Write replay.html, a page to watch, for every run; this takes as long as the exploration itself."""
    baseline: Text = None
    """Measure the other policies against this one in the report; see `asg report --help`."""
    wide: Switch = False
    """Print all columns of the result scene by scene, whatever the width of the terminal."""

    def run(self) -> int:
        """Run the comparison and write its report; return 0 if all runs finished, 1 if some failed, 130 if stopped."""
        return compare_with(self)


# The comparison of `asg compare` without options. Fewer views and points than usual are measured, so it takes about a
# minute on two cores.
DEMO = Compare(scenes=("room",), views=16, samples=50_000)


def compare_with(options: Compare, comparison: Comparison | None = None, *, command: str = "asg compare") -> int:
    """Run the comparison defined by ``options``, or ``comparison`` if it is given, and return the exit code.

    ``command`` is the one that continues the comparison, for the message after Ctrl-C.
    """
    # Options are checked before the slow imports.
    use_trust(options.trust_code)
    console = make_console()
    if options.resume and not options.out:
        raise InputError("--resume needs --out: the directory of the comparison to go on with")
    if options.shard is not None and not options.out:
        raise InputError("--shard needs --out: the directory that all shards share")
    directory = Path(options.out or time.strftime("runs/%Y%m%d-%H%M%S"))
    use_lpips_weights(options.lpips_weights)

    from activestructure_gym.evaluation.running.comparison import jobs_to_resume
    from activestructure_gym.evaluation.running.engines import ENGINES, Limits
    from activestructure_gym.evaluation.running.output_directory import check_output
    from activestructure_gym.evaluation.running.resuming import recorded_jobs
    from activestructure_gym.evaluation.running.sharding import Shard

    limits = Limits(options.workers, options.timeout_min, options.retries)
    ENGINES.get(options.engine).check(limits)
    shard = None if options.shard is None else Shard.parse(options.shard)
    check_output(directory, resume=options.resume, shared=shard is not None)
    began = time.monotonic()
    grid = [one.name for one in dataclasses.fields(GridOptions)]
    as_recorded = comparison is None and options.resume and not _typed(options, *grid)
    if comparison is None and options.resume:
        comparison = _added_to(directory, options)
    demo = comparison is None and not options.scenes
    comparison = comparison or comparison_of(_with_demo_defaults(options) if demo else options)
    if options.engine != "ray" and not as_recorded:
        comparison.check_machine()
    if not options.resume and options.baseline is not None:  # checked before any scene is loaded
        options = _with_baseline(options, comparison.jobs(comparison.participants(), {}))
    if options.dry_run:
        recorded = recorded_jobs(directory) if as_recorded else None
        return _print_plan(console, comparison, recorded, shard, directory, demo=demo)
    with working(console, "loading") as notify:
        jobs = jobs_to_resume(directory, comparison, notify) if as_recorded else comparison.prepare(notify)
    before = recorded_jobs(directory) if options.resume else []
    options = _with_baseline(options, [*jobs, *before])
    if not as_recorded:
        _announce(console, comparison, directory, len(jobs), len({job.policy for job in jobs}), demo=demo)
    return _run_and_report(options, console, jobs, directory, limits, shard, began, command)


def _run_and_report(
    options: Compare,
    console: Console,
    jobs: Sequence[Job],
    directory: Path,
    limits: Limits,
    shard: Shard | None,
    began: float,  # seconds of `time.monotonic`
    command: str,
) -> int:
    """Run the jobs and write the report, or with ``shard`` only run its jobs; return the exit code."""
    from activestructure_gym.evaluation.archive.directory_lock import hold
    from activestructure_gym.evaluation.archive.jobs import policy_label
    from activestructure_gym.evaluation.archive.store import COMPARISON
    from activestructure_gym.evaluation.running.comparison import run_comparison
    from activestructure_gym.evaluation.running.live_progress import LiveProgress

    try:
        with hold(directory, shared=shard is not None) as held:
            given: dict[str, Any] = {
                "engine": options.engine, "limits": limits, "command": _command_line(), "held": held, "shard": shard,
                "notify": lambda text: console.print(f"[yellow]{escape(text)}[/]"),
            }  # fmt: skip
            with LiveProgress(console) as live:
                result = run_comparison(jobs, directory, live, resume=options.resume, **given)
            if shard is not None:
                again = escape(resuming(command, directory, jobs))
                console.print(f"shard {shard} is done; `{again}` writes the report once all are")
                return 1 if result.failed else 0
            seconds = time.monotonic() - began
            if options.replay:  # before the report, which links to the pages
                from activestructure_gym.evaluation.cli.replay import add_replays

                add_replays(console, result.runs)
            baseline = None if options.baseline is None else policy_label(Spec(options.baseline))
            return print_end(console, result, directory, seconds, baseline, wide=options.wide)
    except (KeyboardInterrupt, OSError) as error:  # `main` prints the message of an OSError
        if (directory / COMPARISON).is_file():
            complain(f"stopped; finished runs are kept, go on with: {resuming(command, directory, jobs)}")
        if isinstance(error, OSError):
            raise
        return 130


def _typed(options: Compare, *names: str) -> bool:
    """Return whether the user gave any of the options ``names``, even with its default value.

    The value of an option that is not given is that of the class `Compare`.
    """
    return any(getattr(options, name) != getattr(Compare, name) for name in names)


def resuming(command: str, directory: Path, jobs: Sequence[Job]) -> str:
    """Return the command that goes on with the comparison of some jobs in ``directory``."""
    from activestructure_gym.evaluation.archive.jobs import code_of

    trust = " --trust-code" if any(any(code_of(job)) for job in jobs) else ""
    return f"{command} --out {shlex.quote(str(directory))} --resume{trust}"


def _added_to(directory: Path, options: Compare) -> Comparison | None:
    """Return the comparison recorded in ``directory``, changed by the options that are given.

    Return None if there is no record and ``options`` name scenes. Raise `InputError` if there is neither.
    """
    from activestructure_gym.evaluation.archive.jobs import code_of
    from activestructure_gym.evaluation.archive.store import COMPARISON
    from activestructure_gym.evaluation.running.comparison import Comparison
    from activestructure_gym.evaluation.running.resuming import recorded_jobs
    from activestructure_gym.registry import refuse_code

    jobs = recorded_jobs(directory)
    if not jobs and options.scenes:
        return None
    if not jobs:
        raise InputError(
            f"there is no comparison in '{directory}' to go on with; name --scenes to compare on, or check --out"
        )
    # Code that the user names in an option of this call is trusted; code that only the record names is not.
    words = {
        "scene": ("scenes",), "world": ("scenes",), "policy": ("policies",), "protocol": ("protocols",),
        "metric": ("metrics",),
    }  # fmt: skip
    for kind, name in (code for job in jobs for code in code_of(job)):
        if not _typed(options, *words.get(kind, ("set", "sweep"))):
            refuse_code(kind, name, directory / COMPARISON)
    begun = Comparison.of(jobs)
    changes = _typed_fields(options, begun)
    if {"policies", "references"} & changes.keys():  # then only the given policies and references are added
        changes = {"policies": (), "references": ()} | changes
    return dataclasses.replace(begun, **changes)


def _with_baseline(options: Compare, jobs: Sequence[Job]) -> Compare:
    """Return the options with ``baseline`` replaced by its canonical name.

    It is a policy of the ``jobs``, or with swept values the label of a job. Raise `InputError` for any other.
    """
    from activestructure_gym.evaluation.references.trajectory import named_trajectory
    from activestructure_gym.policies import canonical_policy

    given, known = options.baseline, list(dict.fromkeys(job.policy for job in jobs))
    rows = list(dict.fromkeys(job.label for job in jobs if job.swept))
    if given is None or given in [*known, *rows]:
        return options
    with suppress(InputError):
        called = named_trajectory(given) if Spec(given).kind == "trajectory" else canonical_policy(given)
        if called in known:
            return dataclasses.replace(options, baseline=called)
    raise InputError(f"--baseline is one of the policies, {listed([*known, *rows])}; got '{given}'")


def _with_demo_defaults(options: Compare) -> Compare:
    """Return the options with the values of `DEMO` where the user gave none."""
    return dataclasses.replace(
        options,
        scenes=DEMO.scenes,
        views=DEMO.views if options.views is None else options.views,
        samples=DEMO.samples if options.samples is None else options.samples,
    )


def comparison_of(options: Compare) -> Comparison:
    """Return the comparison defined by the options, with defaults for options that are not given."""
    from activestructure_gym.evaluation.archive.conditions import Conditions
    from activestructure_gym.evaluation.running.comparison import Comparison

    defaults = Comparison(
        scenes=(Spec("room"),),
        policies=(Spec("random"), Spec("activestructure")),
        conditions=Conditions(setup=options.setup or "shared"),
    )
    return dataclasses.replace(defaults, **_typed_fields(options, defaults))


def _typed_fields(options: Compare, begun: Comparison) -> dict[str, Any]:
    """Return the options that the user gave as fields of a `Comparison`, to replace the fields of ``begun``."""
    from activestructure_gym.evaluation.references.trajectory import with_mappers

    changes = options.typed(begun.conditions)
    typed: dict[str, Any] = {}
    if options.scenes:
        typed["scenes"] = split_scenes(options.scenes)
    if options.policies is not None:
        typed["policies"] = with_mappers(split_policies(options.policies), split_list(options.mappers))
    elif options.mappers:
        given = [spec for spec in begun.policies if spec.kind == "trajectory"]
        typed["policies"] = with_mappers(given, split_list(options.mappers))
    if options.references:
        typed["references"] = split_list(options.references)
    if options.seeds is not None:
        typed["seeds"] = parse_seeds(options.seeds)
    if options.sweep:
        typed["sweep"] = {**begun.sweep, **parse_sweep(options.sweep)}
    if options.setup is not None:
        changes["setup"] = options.setup
    if options.start is not None:
        changes["start_pose"] = start_of(options.start, typed.get("scenes", begun.scenes))
    if changes:
        typed["conditions"] = dataclasses.replace(begun.conditions, **changes)
    return typed


def _print_plan(
    console: Console,
    comparison: Comparison,
    recorded: Sequence[Job] | None,  # jobs of the record, if a comparison is resumed without changes
    shard: Shard | None,
    directory: Path,
    *,
    demo: bool,
) -> int:
    """Print the runs of a comparison, or only the runs of ``shard``, without loading a scene; return 0."""
    from activestructure_gym.evaluation.archive.completion import completion_markers

    policies = comparison.participants()
    comparison.check_scene_names()
    jobs = recorded or comparison.jobs(policies, {})
    _announce(console, comparison, directory, len(jobs), len(policies), demo=demo)
    for job in jobs if shard is None else shard.part(jobs):
        console.print(escape(job.title))
    finished = len(completion_markers(directory)) if directory.is_dir() else 0
    kept = f"; {pluralised(finished, 'run')} of the directory finished before and kept" if finished else ""
    console.print(f"Nothing was run (--dry-run){kept}")
    return 0


def _announce(
    console: Console, comparison: Comparison, directory: Path, jobs: int, policies: int, *, demo: bool
) -> None:
    from activestructure_gym.evaluation.protocols import StandardProtocol

    shared = comparison.conditions
    budgets = [shared.frame_budget or config.frame_budget for config in comparison.configurations]
    frames = " or ".join(map(str, dict.fromkeys(budgets)))
    parts = [
        pluralised(len(comparison.scenes), "scene"),
        pluralised(policies, "policy", "policies"),
        pluralised(len(comparison.seeds), "seed"),
        *(f"{pluralised(len(values), 'value')} of {escape(name)}" for name, values in comparison.sweep.items()),
    ]
    conditions = f"{shared.setup} setup, preset {shared.preset}, {frames} frames"
    what = f"[bold]{' x '.join(parts)}[/], {conditions} per run" if jobs > 1 else f"[bold]one run[/], {conditions}"
    console.print(f"{what}, into {escape(str(directory))}")
    if demo:
        protocol, full = shared.protocol, StandardProtocol()
        console.print(
            f"[dim]The demo is measured on {protocol.views} views and {protocol.surface_samples:,} points; with "
            f"--scenes a comparison is measured on {full.views} and {full.surface_samples:,} (asg compare --help)."
        )


def _command_line() -> str:
    return "asg " + shlex.join(sys.argv[1:])
