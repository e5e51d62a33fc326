"""``asg compare``: from the options to the table."""

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

from activestructure_gym.errors import InputError, counted, listed
from activestructure_gym.evaluation.cli.closing import print_end
from activestructure_gym.evaluation.cli.fields import (
    Changes,
    Count,
    NoNames,
    PathName,
    Switch,
    Text,
    ViewSource,
    Words,
    option,
)
from activestructure_gym.evaluation.cli.options import (
    parse_overrides,
    parse_seeds,
    split_list,
    split_policies,
    split_scenes,
    start_of,
    use_lpips_weights,
    use_trust,
)
from activestructure_gym.evaluation.cli.output import make_console, working
from activestructure_gym.policies.schedule import NATIVE_PRESET, Terms
from activestructure_gym.streams import complain, escape

if TYPE_CHECKING:
    from activestructure_gym.evaluation.running.comparison import Comparison


@dataclass(frozen=True)
class Compare:
    """Run policies on scenes under one budget.

    The result is a table and a report page with curves and pictures.
    Without any option: `random` against `activestructure` in a furnished room, in about a minute.
    """

    # What is compared has None, or nothing, where it was not typed: the usual value is put in by `comparison_of`, and
    # by the record where a comparison is gone on with. Nobody can type None.

    scenes: Annotated[tuple[str, ...], option("SCENE [SCENE ...]", "(default: room)")] = ()
    """What to explore, separated by commas or spaces: names (see `asg scenes`), files, folders."""
    policies: Annotated[Words, option("NAME [NAME ...]", "(default: random activestructure)")] = None
    (
        "Who explores: names (see `asg policies`), package.module:Class, `ladder` (the paper's ablation, A to E), or "
        '`all`. Options stand behind a question mark: "active_gs?travel=shared" is a planner with everybody\'s travel '
        "term."
    )
    mappers: NoNames = ()
    (
        "Who maps the trajectories among the policies (trajectory:FILE, :sweep, :passive): default, splatam, monogs, "
        "gaussian_slam, co_slam, one run for each."
    )
    seeds: Annotated[Words, option("N [N ...]", "(default: 0)")] = None
    """Whole numbers from 0 on. Equal seeds start at the same place, so policies are compared in pairs."""
    references: NoNames = ()
    (
        "Who decides by the ground truth, to show what could be reached, and is no policy: oracle (one step, all views "
        "of the pool, what they show first), oracle-quality (later what they mend in the map)."
    )
    terms: Annotated[Terms | None, option("{shared,native}", "(default: shared)")] = None
    (
        "shared: everybody gets the same candidates, keyframes and mapper; native: each brings its own, at 2000 frames "
        "of 320 x 180 (preset full) if not said otherwise."
    )
    preset: Annotated[str | None, option("fast|default|full|paper", "(default: default)")] = None
    """What `asg config PRESET` prints."""
    frames: Count = None
    """Frame budget of every episode; the preset's if not given."""
    out: PathName = None
    """Directory for the results; runs/<date>-<time> if not given."""
    resume: Switch = False
    (
        "Go on with the comparison in --out: finished runs are kept and not repeated. Scenes, policies or seeds given "
        "as well are added to it; everything else stays as it was."
    )
    trust_code: Switch = False
    """Let files (the record of --resume, a checkpoint) name code, package.module:Name, that is run."""
    engine: Annotated[str, option("local|inline|ray")] = "local"
    (
        "local: one process per run, several at a time; inline: one after the other in this process; ray: on a Ray "
        "cluster."
    )
    workers: int = 0
    """Runs at a time; 0 is one per core."""
    shard: Annotated[str | None, option("I/N", "")] = None
    (
        "Run every N-th job, from the I-th one on: N programs with the same options, one for each I, run the whole "
        "comparison into --out. `asg compare --resume --out` then runs what is missing and writes the report."
    )
    timeout: float = 0.0
    """Minutes after which a run is stopped and tried again; 0 is any time."""
    retries: int = 1
    """How often a run is tried again that was killed or ran out of time."""
    start: Annotated[str | None, option("X,Y,Z,YAW", "")] = None
    """Where every episode starts: x,y,z,yaw in metres and degrees (write --start=-1,2,1.4,90), or `published`: where
    papers start in that scene of Replica or Matterport3D."""
    set: Changes = ()
    """Changes of the configuration (see `asg config`), e.g. sensor.depth_noise=kinect mapper.iterations=8."""
    views: Annotated[int | None, option("N", "(default: 64)")] = None
    """Held-out views that PSNR and SSIM are measured on."""
    protocols: Annotated[Words, option("NAME [NAME ...]", "(default: standard)")] = None
    """What finished maps are measured by: standard always is, activegamer can be as well."""
    lpips_weights: PathName = None
    """Folder with AlexNet's and LPIPS's weights. Also looked for: ASG_LPIPS_WEIGHTS, torch's hub cache."""
    samples: Annotated[int | None, option("N", "(default: 200000)")] = None
    """Points of the true surface that geometry is measured on, seen or not."""
    view_source: Annotated[ViewSource | None, option("{free_space,recorded}", "(default: free_space)")] = None
    """Drawn in the scene's free space, or recorded with the scene."""
    replay: Switch = False
    """Also write a page to watch of every run, replay.html beside it; takes as long again as the runs explored."""
    baseline: Text = None
    """The policy the report measures the others against; see `asg report --help`."""
    wide: Switch = False
    """Print all columns of the result scene by scene, whatever the width of the terminal."""

    def run(self) -> int:
        """Check, run, report. 0 if every run finished, 1 if some failed, 130 if stopped."""
        return compare_with(self)


# What differs without any option: measured on less, to end in about a minute on two cores.
DEMO = Compare(scenes=("room",), views=16, samples=50_000)


# What names cells of the grid. Where none of it is typed, those of the record are gone on with, and no others.
_GRID = ("scenes", "policies", "mappers", "seeds", "references")


def compare_with(options: Compare, comparison: Comparison | None = None) -> int:
    """Do what the options say; with a ``comparison``, that one in place of what they name."""
    # Before the slow imports: a directory that cannot be used is known at once.
    from activestructure_gym.evaluation.archive.store import COMPARISON

    use_trust(options.trust_code)
    console = make_console()
    if options.resume and not options.out:
        raise InputError("--resume needs --out: the directory of the comparison to go on with")
    if options.shard is not None and not options.out:
        raise InputError("--shard needs --out: the directory that all shards share")
    directory = Path(options.out or time.strftime("runs/%Y%m%d-%H%M%S"))
    use_lpips_weights(options.lpips_weights)

    from activestructure_gym.evaluation.archive.comparison import read_record
    from activestructure_gym.evaluation.archive.directory_lock import hold
    from activestructure_gym.evaluation.archive.jobs import code_of, policy_label
    from activestructure_gym.evaluation.running.comparison import check_output, jobs_to_resume, run_comparison
    from activestructure_gym.evaluation.running.engines import Limits, get_engine
    from activestructure_gym.evaluation.running.sharding import Shard

    limits = Limits(options.workers, options.timeout, options.retries)
    get_engine(options.engine).check(limits)
    shard = None if options.shard is None else Shard.parse(options.shard)
    check_output(directory, resume=options.resume, shared=shard is not None)
    began = time.monotonic()
    as_recorded = comparison is None and options.resume and not _typed(options, *_GRID)
    if comparison is None and options.resume:
        comparison = _added_to(directory, options)
    demo = comparison is None and not options.scenes
    comparison = comparison or comparison_of(_with_demo_defaults(options) if demo else options)
    if options.engine != "ray" and not as_recorded:
        comparison.check_machine()
    if not options.resume and options.baseline is not None:  # who would take part is known before anything is loaded
        options = _with_baseline(options, comparison.everybody())
    with working(console, "loading") as notify:
        jobs = jobs_to_resume(directory, comparison, notify) if as_recorded else comparison.prepare(notify)
    policies = list(dict.fromkeys(job.policy for job in jobs))
    before = ((read_record(directory) or {}) if options.resume else {}).get("jobs", {}).values()
    known = list(dict.fromkeys((*policies, *(job["policy"] for job in before))))
    options = _with_baseline(options, known)
    if not as_recorded:
        _announce(console, comparison, directory, len(jobs), len(policies), demo=demo)

    from activestructure_gym.evaluation.running.live_progress import LiveProgress

    try:
        with hold(directory, shared=shard is not None) as held:
            given: dict[str, Any] = {
                "engine": options.engine, "limits": limits, "command": _command_line(), "held": held, "shard": shard,
                "tell": lambda text: console.print(f"[yellow]{escape(text)}[/]"),
            }  # fmt: skip
            with LiveProgress(console) as live:
                result = run_comparison(jobs, directory, live, resume=options.resume, **given)
            if shard is not None:
                again = escape(f"asg compare --resume --out {shlex.quote(str(directory))}")
                console.print(f"shard {shard} is done; `{again}` writes the report once all are")
                return 1 if result.failed else 0
            seconds = time.monotonic() - began
            if options.replay:  # before the report, which links to them
                from activestructure_gym.evaluation.cli.replay import add_replays

                add_replays(console, result.runs)
            baseline = None if options.baseline is None else policy_label(options.baseline)
            return print_end(console, result, directory, seconds, baseline, wide=options.wide)
    except (KeyboardInterrupt, OSError) as error:  # an OSError, of a full disk, is said by who called
        if (directory / COMPARISON).is_file():
            trust = " --trust-code" if any(any(code_of(job)) for job in jobs) else ""
            complain(
                "stopped; finished runs are kept, go on with: "
                f"asg compare --out {shlex.quote(str(directory))} --resume{trust}"
            )
        if isinstance(error, OSError):
            raise
        return 130


def _typed(options: Compare, *names: str) -> bool:
    """Whether any of these options was typed, those of what is compared; a typed one may well say what is usual."""
    return any(getattr(options, name) != getattr(Compare, name) for name in names)


def _added_to(directory: Path, options: Compare) -> Comparison | None:
    """The comparison in a directory with what was typed in place of what it has; None where it has no record.

    Raises `InputError` where there is none and no scenes are named, which would begin another.
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
    words = {"scene": "scenes", "policy": "policies"}  # what the user says himself needs no trust
    for kind, name in (code for job in jobs for code in code_of(job)):
        if not _typed(options, words.get(kind, "set")):
            refuse_code(kind, name, directory / COMPARISON)
    begun = Comparison.of(jobs)
    changes = _typed_fields(options, begun)
    if {"policies", "references"} & changes.keys():  # who is added, and nobody else
        changes = {"policies": (), "references": ()} | changes
    return dataclasses.replace(begun, **changes)


def _with_baseline(options: Compare, known: Sequence[str]) -> Compare:
    """The options with the baseline called as its jobs are; raises `InputError` where it does not take part."""
    from activestructure_gym.evaluation.archive.jobs import is_trajectory
    from activestructure_gym.evaluation.references.trajectory import named_trajectory
    from activestructure_gym.policies import canonical_policy

    given = options.baseline
    if given is None or given in known:
        return options
    with suppress(InputError):
        called = named_trajectory(given) if is_trajectory(given) else canonical_policy(given)
        if called in known:
            return dataclasses.replace(options, baseline=called)
    raise InputError(f"--baseline is one of the policies, {listed(known)}; got '{given}'")


def _with_demo_defaults(options: Compare) -> Compare:
    """The options as given, and the demo's where none is."""
    return dataclasses.replace(
        options,
        scenes=DEMO.scenes,
        views=DEMO.views if options.views is None else options.views,
        samples=DEMO.samples if options.samples is None else options.samples,
    )


def comparison_of(options: Compare) -> Comparison:
    """The comparison that the options name; what was not typed is as usual."""
    from activestructure_gym.evaluation.running.comparison import Comparison

    usual = Comparison(
        scenes=("room",),
        policies=("random", "activestructure"),
        preset=NATIVE_PRESET if options.terms == "native" else "default",
    )
    return dataclasses.replace(usual, **_typed_fields(options, usual))


def _typed_fields(options: Compare, begun: Comparison) -> dict[str, Any]:
    """What was typed, and nothing else, as fields of a comparison that takes their place in ``begun``."""
    from activestructure_gym.config import known_preset
    from activestructure_gym.evaluation.archive.jobs import is_trajectory
    from activestructure_gym.evaluation.references.trajectory import with_mappers

    overrides = parse_overrides(options.set)
    if options.frames is not None and "frame_budget" in overrides:
        raise InputError(f"--frames {options.frames} and --set frame_budget={overrides['frame_budget']}: leave one out")
    typed: dict[str, Any] = {}
    if options.scenes:
        typed["scenes"] = split_scenes(options.scenes)
    if options.policies is not None:
        typed["policies"] = with_mappers(split_policies(options.policies), split_list(options.mappers))
    elif options.mappers:
        typed["policies"] = with_mappers(list(filter(is_trajectory, begun.policies)), split_list(options.mappers))
    if options.references:
        typed["references"] = split_list(options.references)
    if options.seeds is not None:
        typed["seeds"] = parse_seeds(options.seeds)
    if options.preset is not None:
        typed["preset"] = known_preset(options.preset)
    if options.terms is not None:
        typed["terms"] = options.terms
    if options.frames is not None:
        typed["frame_budget"] = options.frames
    if options.set:
        typed["overrides"] = overrides
    if options.start is not None:
        typed["start_pose"] = start_of(options.start, typed.get("scenes", begun.scenes))
    said = {"views": options.views, "surface_samples": options.samples, "view_source": options.view_source}
    measured: dict[str, Any] = {name: value for name, value in said.items() if value is not None}
    if measured:
        typed["protocol"] = dataclasses.replace(begun.protocol, **measured)
    if options.protocols is not None:
        typed["also_protocols"] = [name for name in split_list(options.protocols) if name != begun.protocol.name]
    return typed


def _announce(
    console: Console, comparison: Comparison, directory: Path, jobs: int, policies: int, *, demo: bool
) -> None:
    from activestructure_gym.config import configure
    from activestructure_gym.evaluation.protocols import StandardProtocol

    frames = comparison.frame_budget or configure(comparison.preset, comparison.overrides).frame_budget
    parts = [
        counted(len(comparison.scenes), "scene"),
        counted(policies, "policy", "policies"),
        counted(len(comparison.seeds), "seed"),
    ]
    conditions = f"{comparison.terms} terms, preset {comparison.preset}, {frames} frames"
    what = f"[bold]{' x '.join(parts)}[/], {conditions} per run" if jobs > 1 else f"[bold]one run[/], {conditions}"
    console.print(f"{what}, into {escape(str(directory))}")
    if demo:
        protocol, usual = comparison.protocol, StandardProtocol()
        console.print(
            f"[dim]The demo is measured on {protocol.views} views and {protocol.surface_samples:,} points; with "
            f"--scenes a comparison is measured on {usual.views} and {usual.surface_samples:,} (asg compare --help)."
        )


def _command_line(arguments: Sequence[str] | None = None) -> str:
    return "asg " + shlex.join(sys.argv[1:] if arguments is None else arguments)
