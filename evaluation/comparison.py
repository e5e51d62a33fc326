"""Comparing policies: scenes x policies x seeds under one budget, checked before anything is written."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation import machine, store
from activestructure_gym.evaluation.engines import Listener, Outcome, get_engine
from activestructure_gym.evaluation.engines.base import JOBS, run_directory
from activestructure_gym.evaluation.jobs import Job, absolute_spec, scene_labels
from activestructure_gym.evaluation.protocols import StandardProtocol, get_protocol
from activestructure_gym.evaluation.store import Run
from activestructure_gym.evaluation.threads import core_count
from activestructure_gym.evaluation.warmup import warming_up

if TYPE_CHECKING:
    from activestructure_gym.scenes import Scene


@dataclass(frozen=True)
class Comparison:
    """What is compared, and under which conditions; the same for every policy."""

    scenes: Sequence[str]
    policies: Sequence[str]
    seeds: Sequence[int] = (0,)
    preset: str = "default"
    frame_budget: int | None = None  # frames; None = the preset's
    overrides: Mapping[str, Any] = field(default_factory=dict)  # of the preset's fields
    start_pose: tuple[float, float, float, float] | None = None  # x, y, z metres, yaw deg
    protocol: StandardProtocol = field(default_factory=StandardProtocol)
    also_protocols: Sequence[str] = ()  # every finished map is measured by these too

    def __post_init__(self) -> None:
        for name in ("scenes", "policies", "seeds"):
            given = getattr(self, name)
            if not given:
                raise InputError(f"a comparison needs at least one of {name}, got none")
            object.__setattr__(self, name, tuple(dict.fromkeys(given)))  # each once, in the order given
        object.__setattr__(self, "scenes", tuple(absolute_spec(spec) for spec in self.scenes))

    def prepare(self, notify: Callable[[str], None] = lambda _: None) -> list[Job]:
        """Check everything a job could fail on, and compute what all jobs of a scene share.

        Loads every scene, finds its free space, and fills the cache with its observable surface and its held-out
        views. Writes nothing but that cache. Returns the jobs, seeds in the outer loop, so that a comparison that is
        stopped early has compared something. Raises `InputError` for the first thing that cannot work.
        """
        self._check_policies()
        hashes = {}
        with warming_up(self.policies, self.overrides, notify):
            for number, spec in enumerate(self.scenes, start=1):
                notify(f"preparing scene {spec} ({number} of {len(self.scenes)})")
                hashes[spec] = self._check_scene(spec).content_hash
            notify("making sure that all kernels are compiled")
        return [
            Job(
                scene=scene,
                policy=policy,
                seed=seed,
                scene_hash=hashes[scene],
                preset=self.preset,
                frame_budget=self.frame_budget,
                overrides=tuple(self.overrides.items()),
                start_pose=self.start_pose,
                protocol=self.protocol,
                also=tuple(self.also_protocols),
            )
            for seed in self.seeds
            for scene in self.scenes
            for policy in self.policies
        ]

    def _check_policies(self) -> None:
        from activestructure_gym.config import configure
        from activestructure_gym.policies import POLICIES, Policy

        configure(self.preset, self.overrides)  # what policies replace must be usable too
        changes = dict(self.overrides)
        if self.frame_budget is not None:
            changes["frame_budget"] = self.frame_budget
        for name in self.policies:
            policy = POLICIES.get(name)
            if not (isinstance(policy, type) and issubclass(policy, Policy)):
                raise InputError(f"policy '{name}' is not a class derived from activestructure_gym.policies.Policy")
            configure(self.preset, changes | {"gains": tuple(policy.required_gains)})
        for seed in self.seeds:
            Job(scene="", policy="", seed=seed, protocol=self.protocol, also=tuple(self.also_protocols))

    def _check_scene(self, spec: str) -> Scene:
        from activestructure_gym.config import configure
        from activestructure_gym.envs.reconstruction_env import as_pose
        from activestructure_gym.scenes import check_start_pose, load_scene
        from activestructure_gym.volume.voxel_volume import grid_shape

        scene = load_scene(spec)
        config = configure(self.preset, self.overrides)
        grid_shape(scene.bounds, config.volume.voxel_size)
        if not len(scene.free_space.start_poses) and self.start_pose is None:
            raise InputError(f"scene '{spec}' has no place to start from: give one with --start x,y,z,yaw")
        if self.start_pose is not None:
            check_start_pose(scene, as_pose(self.start_pose), config.motion.body_radius)
        self.protocol.truth(scene)
        for name in self.also_protocols:
            get_protocol(name).truth(scene)
        return scene


@dataclass(frozen=True)
class Result:
    """What came out of a comparison."""

    runs: list[Run]  # every finished job of the grid, those of earlier sittings included
    failed: list[Outcome]
    skipped: int  # finished before, and not run again


def check_output(directory: Path, *, resume: bool) -> None:
    """Refuse a directory that cannot be written, or that holds something else; raises `InputError`."""
    if directory.exists() and not directory.is_dir():
        raise InputError(f"the output '{directory}' is a file; give a directory that is new, empty, or a comparison's")
    if directory.is_dir() and any(directory.iterdir()):
        if not (directory / store.COMPARISON).is_file():
            raise InputError(f"the output '{directory}' holds other files; give a directory that is new or empty")
        if not resume:
            raise InputError(f"'{directory}' holds a comparison already; add --resume to go on, or choose another one")
    parent = directory
    while not parent.exists():
        parent = parent.parent
    if not parent.is_dir():
        raise InputError(f"the output '{directory}' cannot be made: '{parent}' is a file")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise InputError(f"the output '{directory}' cannot be written: no permission in '{parent}'")


def run_comparison(
    jobs: Sequence[Job],
    directory: Path,
    listener: Listener,
    *,
    engine: str = "local",
    workers: int = 0,  # jobs at a time; 0 = one per core
    command: str = "",  # how the comparison was asked for; kept in the archive
) -> Result:
    """Run the jobs that are not finished yet in ``directory``, and read all finished ones back.

    Unfinished jobs are never counted, finished ones never repeated. Call `check_output` first.
    """
    run = get_engine(engine)
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"the output '{directory}' cannot be made: {error.strerror}") from error
    store.remove_parts(directory / JOBS)
    todo = [job for job in jobs if not store.is_done(run_directory(directory, job), job)]
    slots = 1 if engine == "inline" else max(1, min(len(todo), workers or core_count()))
    record = {
        "format": store.FORMAT_VERSION,
        "command": command,
        "engine": engine,
        "workers": slots,
        "jobs": {job.name: job.as_dict() for job in jobs},
        "failed": {},
        "versions": machine.versions(),
        "hardware": machine.hardware(),
    }
    store.write_json(directory / store.COMPARISON, record)
    outcomes = run(todo, directory, listener, slots) if todo else []
    failed = [outcome for outcome in outcomes if not outcome.finished]
    if failed:
        record["failed"] = {outcome.job.title: outcome.error for outcome in failed}
        store.write_json(directory / store.COMPARISON, record)
    return Result(finished_runs(directory, jobs), failed, skipped=len(jobs) - len(todo))


def finished_runs(directory: Path, jobs: Sequence[Job]) -> list[Run]:
    """The finished ones of these jobs, in their order."""
    labels = scene_labels(job.scene for job in jobs)
    places = [(run_directory(directory, job), job) for job in jobs]
    return [store.read_run(place, labels[job.scene]) for place, job in places if store.is_done(place, job)]


def open_comparison(directory: Path) -> list[Run]:
    """All finished runs of a comparison's directory; raises `InputError` if its record cannot be read."""
    try:
        contents = list(store.read_json(directory / store.COMPARISON)["jobs"].values())
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"'{directory}' cannot be read as a comparison ({type(error).__name__}: {error})") from error
    return finished_runs(directory, [Job.from_dict(content) for content in contents])
