"""``asg score``: a trajectory of any system, through our sensor, map and protocols."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.compare import Compare, compare_with, comparison_of
from activestructure_gym.evaluation.cli.fields import Changes, Count, Names, NoNames, PathName, Switch, option
from activestructure_gym.evaluation.cli.options import parse_start, split_list, use_trust

if TYPE_CHECKING:
    from activestructure_gym.evaluation.archive.store import Run
    from activestructure_gym.evaluation.running.comparison import Comparison


@dataclass(frozen=True)
class Score:
    """Map a recorded trajectory and measure the map.

    A run's own trajectory gives the run's own map again, byte for byte: asg score --trajectory RUN.
    """

    trajectory: PathName = None
    """A file of poses, a folder that has one (traj.txt, traj_w_c.txt, trajectory.npz, pose), or a finished run."""
    scene: Annotated[str | None, option("SCENE", "")] = None
    """What is explored; a run's own, with its seed and configuration, if not given."""
    format: Literal["auto", "tum", "nice_slam", "kitti", "replica", "habitat", "scannet", "scannetpp", "npz"] = "auto"
    """How the file is written; auto goes by its ending and by the numbers in a line."""
    axes: Annotated[str | None, option("opencv|opengl|habitat|ros", "(default: opencv; habitat's own)")] = None
    """Whose axes its poses have. Poses that cannot be are refused, with the convention that fits best."""
    inverted: Switch = False
    """The poses map world to camera."""
    start: Annotated[str | None, option("X,Y,Z,YAW", "")] = None
    """Where the first pose is put, for files in the frame of their first camera (write --start=-1,2,1.4,90)."""
    mapper: NoNames = ()
    """Who maps it: default, splatam, monogs, gaussian_slam, co_slam, one run for each."""
    frames: Count = None
    """Frame budget; all poses if not given."""
    seeds: Annotated[tuple[str, ...], option("N [N ...]", "")] = ()
    """Of the sensor's noise and of the mapper; 0, or the run's own, if not given."""
    preset: Annotated[str | None, option("fast|default|full|paper", "(default: default)")] = None
    """What `asg config PRESET` prints."""
    set: Changes = ()
    """Changes of the configuration (see `asg config`)."""
    out: PathName = None
    """Directory for the results; runs/<date>-<time> if not given."""
    resume: Switch = False
    """Go on with what is in --out, or add to it."""
    engine: Annotated[str, option("local|inline|ray")] = "local"
    """As for `asg compare`."""
    workers: int = 0
    """Runs at a time; 0 is one per core."""
    views: Annotated[int | None, option("N", "(default: 64)")] = None
    """Held-out views that PSNR and SSIM are measured on."""
    samples: Annotated[int | None, option("N", "(default: 200000)")] = None
    """Points of the true surface that geometry is measured on, seen or not."""
    view_source: Literal["free_space", "recorded"] = "free_space"
    """Drawn in the scene's free space, or recorded with the scene."""
    protocols: Names = ("standard",)
    """What finished maps are measured by: standard always is, activegamer can be as well."""
    lpips_weights: PathName = None
    """Folder with AlexNet's and LPIPS's weights."""
    trust_code: Switch = False
    """Let a run's files name code, package.module:Name, that is run."""

    def run(self) -> int:
        """Check, follow, report; exit codes as of `asg compare`."""
        use_trust(self.trust_code)
        if self.trajectory is None:
            raise InputError("give a trajectory to follow with --trajectory: a file of poses, or a finished run")
        run = _run_of(self.trajectory)
        if self.scene is None and run is None:
            raise InputError(f"'{self.trajectory}' is no finished run, which would name its scene: give --scene")
        return compare_with(*_asked(self, run))


def _run_of(place: str) -> Run | None:
    """The finished run whose trajectory it is."""
    from activestructure_gym.evaluation.archive.store import DONE, read_run

    directory = Path(place) if Path(place).is_dir() else Path(place).parent
    return read_run(directory) if (directory / DONE).is_file() else None


def _asked(options: Score, run: Run | None) -> tuple[Compare, Comparison]:
    """The same question in `asg compare`'s words, and the comparison."""
    from activestructure_gym.evaluation.references.trajectory import TrajectorySpec

    assert options.trajectory is not None
    given = TrajectorySpec(
        options.trajectory,
        kind=options.format,
        axes=options.axes or "",
        inverted=options.inverted,
        start=parse_start(options.start),
    )
    specs = [dataclasses.replace(given, mapper=name).spec for name in split_list(options.mapper) or ("",)]
    same = {name: getattr(options, name) for name in _SHARED}
    asked = Compare(**same, scenes=(options.scene or "",), policies=tuple(specs), seeds=options.seeds or None)
    if run is None or options.scene is not None:
        comparison = comparison_of(asked)
        if options.frames is None:
            comparison = dataclasses.replace(comparison, frame_budget=given.frames)
        return asked, comparison
    job = run.job
    asked = dataclasses.replace(asked, scenes=(job.scene,), preset=options.preset or job.preset)
    if not options.seeds:
        asked = dataclasses.replace(asked, seeds=(str(job.seed),))
    comparison = comparison_of(asked)
    return asked, dataclasses.replace(
        comparison,
        frame_budget=options.frames if options.frames is not None else run.config["configuration"]["frame_budget"],
        overrides=_changes_of(run) | dict(comparison.overrides),
        recorded={job.scene: job.scene_hash},
    )


_SHARED = (
    "frames", "preset", "set", "out", "resume", "engine", "workers", "views", "samples", "view_source", "protocols",
    "lpips_weights", "trust_code",
)  # fmt: skip


def _changes_of(run: Run) -> dict[str, Any]:
    """What the run's configuration differs in from its preset's; what was computed for its policy alone is no part."""
    from activestructure_gym.evaluation.archive.jobs import is_reference, is_trajectory, refuse_code
    from activestructure_gym.evaluation.archive.store import CONFIG
    from activestructure_gym.evaluation.references.trajectory import TrajectorySpec
    from activestructure_gym.policies import make_policy

    job = run.job
    if job.terms == "shared":
        refuse_code([dataclasses.replace(job, policy="random")], run.directory / CONFIG)
        brought = dict(job.overrides)
    else:
        refuse_code([job], run.directory / CONFIG)
        alone = is_reference(job.policy) or is_trajectory(job.policy)
        brought = job.changes(None if alone else make_policy(job.policy))
    if is_trajectory(job.policy) and (mapper := TrajectorySpec.of(job.policy).mapper):
        brought["mapper.name"] = mapper
    return {name: value for name, value in brought.items() if name not in ("gains", "frame_budget")}
