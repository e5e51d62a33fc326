"""Define ``asg replay-trajectory``, which maps along a recorded trajectory and measures the map."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.evaluation.cli.compare import Compare, compare_with, comparison_of
from activestructure_gym.evaluation.cli.conditions import ConditionOptions, RunOptions
from activestructure_gym.evaluation.cli.fields import NoNames, Switch, option
from activestructure_gym.evaluation.cli.options import parse_start, split_list, use_trust
from activestructure_gym.specs import Spec

if TYPE_CHECKING:
    from activestructure_gym.evaluation.archive.store import Run
    from activestructure_gym.evaluation.running.comparison import Comparison


@dataclass(frozen=True)
class TrajectoryOptions:
    """Hold the options for a trajectory, its frame and its mapper."""

    trajectory: Annotated[str, tyro.conf.Positional, option("TRAJECTORY")]
    """Follow a file of poses, a folder with one (traj.txt, transforms.json, sparse/0, pose), or a finished run."""
    scene: Annotated[str | None, option("SCENE", "")] = None
    """Explore this scene; by default a run's own, with its seed and configuration."""
    format: Literal[
        "auto", "tum", "nice_slam", "kitti", "replica", "redwood", "nerfstudio", "colmap", "euroc", "ros_csv",
        "habitat", "scannet", "scannetpp", "npz",
    ] = "auto"  # fmt: skip
    """Read the file in this format; auto recognises it by its content."""
    axes: Annotated[str | None, option("opencv|opengl|habitat|ros", "(default: by the format, mostly opencv)")] = None
    """Read poses in these axes; poses in walls are refused, and the error names the axes that fit best."""
    inverted: Switch = False
    """Read poses that map world to camera."""
    start: Annotated[str | None, option("X,Y,Z,YAW", "")] = None
    """Put the first pose here, for files in the frame of their first camera (write --start=-1,2,1.4,90)."""
    keyframes: Annotated[str, option("all|N|FILE", "")] = ""
    """Map all poses, every N-th, or those that a file lists by index or time stamp; by default every
    `keyframe_every`-th, or those of the run."""
    reference: Annotated[str | None, option("FILE", "")] = None
    """Measure ATE and RPE of the poses against this trajectory, which is in the frame of the scene."""
    align: Literal["none", "se3", "sim3"] = "none"
    """Move the poses to the reference before they are mapped: rigidly (se3) or with a scale (sim3)."""
    mappers: NoNames = ()
    """Map by default, splatam, monogs, gaussian_slam or co_slam, one run for each."""
    seeds: Annotated[tuple[str, ...], option("N [N ...]", "")] = ()
    """Use these seeds for the sensor's noise and the mapper; by default 0, or the run's own."""


@dataclass(frozen=True)
class ReplayTrajectory(RunOptions, ConditionOptions, TrajectoryOptions):
    """Map a recorded trajectory and measure the map.

    With a finished run as TRAJECTORY the result is that run's map, byte for byte.
    """

    def run(self) -> int:
        """Check the trajectory, map along it and write the report; the exit codes are those of `asg compare`."""
        use_trust(self.trust_code)
        run = _run_of(self.trajectory)
        if self.scene is None and run is None:
            if not Path(self.trajectory).exists():
                raise InputError(f"there is no trajectory {short_repr(self.trajectory)}")
            raise InputError(f"'{self.trajectory}' is not a finished run, which would name its scene: give --scene")
        return compare_with(*_asked(self, run))


def _run_of(place: str) -> Run | None:
    """Return the finished run to which the trajectory at the path ``place`` belongs, or None."""
    from activestructure_gym.evaluation.archive.completion import DONE
    from activestructure_gym.evaluation.archive.store import read_run

    directory = Path(place) if Path(place).is_dir() else Path(place).parent
    return read_run(directory) if (directory / DONE).is_file() else None


def _asked(options: ReplayTrajectory, run: Run | None) -> tuple[Compare, Comparison]:
    """Return the equivalent options of `asg compare` and the comparison to run.

    If ``run`` is given and no scene, the comparison repeats the scene, the seed and the configuration of that run.
    """
    from activestructure_gym.evaluation.references.trajectory import TrajectorySpec

    given = TrajectorySpec(
        options.trajectory,
        format=options.format,
        axes=options.axes or "",
        inverted=options.inverted,
        start=parse_start(options.start),
        keyframes=options.keyframes,
        reference=options.reference or "",
        align="" if options.align == "none" else options.align,
    )
    given.check()
    specs = [replace(given, mapper=name).spec for name in split_list(options.mappers) or ("",)]
    same = {one.name: getattr(options, one.name) for kind in (RunOptions, ConditionOptions) for one in fields(kind)}
    asked = Compare(**same, scenes=(options.scene or "",), policies=tuple(specs), seeds=options.seeds or None)
    if run is None or options.scene is not None:
        comparison = comparison_of(asked)
        if options.frames is None:
            comparison = replace(comparison, conditions=replace(comparison.conditions, frame_budget=given.frames))
        return asked, comparison
    job = run.job
    asked = replace(asked, scenes=(job.scene,), preset=options.preset or job.conditions.preset)
    if not options.seeds:
        asked = replace(asked, seeds=(str(job.seed),))
    comparison = comparison_of(asked)
    budget = options.frames if options.frames is not None else run.config["configuration"]["frame_budget"]
    overrides = _changes_of(run) | dict(comparison.conditions.overrides)
    conditions = replace(comparison.conditions, frame_budget=budget, overrides=overrides)
    return asked, replace(comparison, conditions=conditions, recorded={job.scene: job.scene_hash})


def _changes_of(run: Run) -> dict[str, Any]:
    """Return the configuration fields in which a run differs from its preset, without features and frame budget."""
    from activestructure_gym.evaluation.archive.jobs import refuse_code
    from activestructure_gym.evaluation.archive.store import CONFIG
    from activestructure_gym.evaluation.references.trajectory import TrajectorySpec
    from activestructure_gym.policies import make_policy

    job = run.job
    if job.conditions.setup == "shared":
        refuse_code([replace(job, policy=Spec("random"))], run.directory / CONFIG)
        changes = dict(job.conditions.overrides)
    else:
        refuse_code([job], run.directory / CONFIG)
        alone = job.policy.kind in ("reference", "trajectory")
        changes = job.conditions.changes(None if alone else make_policy(job.policy))
    if job.policy.kind == "trajectory" and (mapper := TrajectorySpec.of(job.policy).mapper):
        changes["mapper.name"] = mapper
    return {name: value for name, value in changes.items() if name not in ("features", "frame_budget")}
