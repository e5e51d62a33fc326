"""Compare policies: run scenes x policies x seeds under one budget, after checking all inputs."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.evaluation.archive import completion, json_files, store, temporary
from activestructure_gym.evaluation.archive.comparison import finished_runs, read_record, run_directory
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import (
    REFERENCE,
    Job,
    absolute_spec,
    refuse_code,
)
from activestructure_gym.evaluation.archive.plugin_code import first_checksum_of, plugin_code_of
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.protocols import get_protocol
from activestructure_gym.evaluation.protocols.metrics import get_metrics
from activestructure_gym.evaluation.references.trajectory import PASSIVE, TrajectorySpec
from activestructure_gym.evaluation.running.engines import ENGINES, Limits, Listener, Outcome
from activestructure_gym.evaluation.running.output_directory import already_begun
from activestructure_gym.evaluation.running.record import Recording, changing, new_record
from activestructure_gym.evaluation.running.recorded_scene import scene_as_recorded
from activestructure_gym.evaluation.running.resuming import merged, recorded_jobs, review_finished
from activestructure_gym.evaluation.running.sharding import Shard
from activestructure_gym.evaluation.running.surroundings import refuse_without_truth, world_hash
from activestructure_gym.evaluation.running.sweep import (
    check_effect,
    checked_sweep,
    combinations,
    refuse_camera,
    sweep_of,
)
from activestructure_gym.evaluation.running.warmup import warming_up
from activestructure_gym.policies.native_settings import native_settings_of
from activestructure_gym.specs import Spec
from activestructure_gym.worlds import names_world
from activestructure_gym.worlds.registry import check_world_name

if TYPE_CHECKING:
    from activestructure_gym.config import ReconstructionConfig
    from activestructure_gym.scenes import Scene


@dataclass(frozen=True)
class Comparison:
    """Define a grid of jobs: scenes, policies, seeds, swept values, and the conditions that all of them share.

    Parameters
    ----------
    scenes
        Scene specs as `load_scene` takes them. Texts are parsed.
    policies
        Names with options. Texts are parsed.
    seeds
        Seeds from 0; runs with equal seeds share start and noise.
    references
        Names of references, which use the ground truth.
    conditions
        Conditions of all runs.
    sweep
        Values by configuration field: every policy runs with each of them, on top of the conditions. Several fields
        give all combinations. Example: ``{"mapper.seed_spacing": (0.06, 0.12)}``.
    recorded
        Content hash by scene, for scenes of a comparison that is resumed.
    """

    scenes: Sequence[Spec]
    policies: Sequence[Spec]
    seeds: Sequence[int] = (0,)
    references: Sequence[str] = ()
    conditions: Conditions = field(default_factory=Conditions)
    sweep: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    recorded: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "sweep", checked_sweep(self.sweep, self.conditions))
        if world := next(filter(names_world, self.scenes), None):
            refuse_camera(self.sweep, world)
        object.__setattr__(self, "scenes", [Spec(absolute_spec(Spec(spec))) for spec in self.scenes])
        object.__setattr__(self, "policies", list(map(Spec, self.policies)))
        for name in ("scenes", "policies", "seeds", "references"):
            given = tuple(getattr(self, name))
            if not given and name != "references" and not (name == "policies" and self.references):
                raise InputError(f"a comparison needs at least one of {name}, got none")
            object.__setattr__(self, name, tuple(dict.fromkeys(given)))  # each once, in the order given

    @classmethod
    def of(cls, jobs: Sequence[Job]) -> Comparison:
        """Return the smallest comparison that contains all of these jobs, which share conditions and swept fields."""
        return cls(
            scenes=[job.scene for job in jobs],
            policies=[job.policy for job in jobs if job.policy.kind != "reference"],
            references=[job.policy.removeprefix(REFERENCE) for job in jobs if job.policy.kind == "reference"],
            seeds=[job.seed for job in jobs],
            conditions=jobs[0].shared_conditions,
            sweep=sweep_of(jobs),
            recorded={job.scene: job.scene_hash for job in jobs},
        )

    def check_machine(self) -> None:
        """Raise `InputError` if this machine cannot run the jobs. Machines of a cluster may differ."""
        from activestructure_gym.compiling import check_compiling
        from activestructure_gym.splatting.rasterizers import rasterizer

        check_compiling()
        for config in self.configurations:
            rasterizer(config.mapper.backend)

    @cached_property
    def all_conditions(self) -> list[Conditions]:
        """Return the conditions with each combination of swept values; without a sweep, the conditions alone."""
        return combinations(self.sweep, self.conditions)

    @cached_property
    def configurations(self) -> list[ReconstructionConfig]:
        """Return the configuration of each of `all_conditions`, before policies replace fields of it."""
        from activestructure_gym.config import configure

        return [configure(one.preset, one.overrides) for one in self.all_conditions]

    def jobs(self, policies: Sequence[Spec], hashes: Mapping[Spec, str]) -> list[Job]:
        """Return all jobs: by seed, then scene, policy and swept values; ``hashes`` has the content hash by scene."""
        return [
            Job(scene, policy, seed, hashes.get(scene, ""), conditions, tuple(self.sweep))
            for seed in self.seeds
            for scene in self.scenes
            for policy in policies
            for conditions in self.all_conditions
        ]

    def participants(self, policies: Sequence[Spec] = ()) -> list[Spec]:
        """Return the ``policy`` of all jobs: the policies, then the references.

        ``policies`` are the canonical names, if they are already known.
        """
        from activestructure_gym.evaluation.references.oracles import reference_job

        return [*(policies or self._check_policies()), *map(reference_job, self.references)]

    def check_scene_names(self) -> None:
        """Raise `InputError` if a scene has an unknown name or a missing file; load none."""
        from activestructure_gym.scenes.library import check_scene_name

        for spec in self.scenes:
            if names_world(spec):
                check_world_name(spec)
            elif not self.recorded.get(spec):  # `scene_as_recorded` finds a file that has moved
                check_scene_name(spec)

    def prepare(self, notify: Callable[[str], None] = lambda _: None) -> list[Job]:
        """Check all inputs, fill the caches that the jobs of a scene share, and return the jobs.

        Every scene is loaded, and its free space, observable surface and held-out views are computed. Only the cache is
        written. The seed is the outer loop of the jobs, so that a comparison that is stopped early has runs of all
        policies. Raise `InputError` for the first invalid input, and give an `InputWarning` if runs have no map.
        """
        policies = self._check_policies()
        self._warn_without_map()
        participants = self.participants(policies)
        self.check_scene_names()
        hashes = {}
        planners = [policy for policy in policies if policy.kind != "trajectory"]
        with warming_up(planners or ["random"], notify):
            for number, spec in enumerate(self.scenes, start=1):
                notify(f"preparing scene {spec} ({number} of {len(self.scenes)})")
                if names_world(spec):  # a robot is reached only when its episode is played
                    hashes[spec] = world_hash(spec)
                else:
                    hashes[spec] = self._check_scene(spec, policies).content_hash
            notify("making sure that all kernels are compiled")
        jobs = self.jobs(participants, hashes)
        _refuse_twins(jobs)
        for job in (job for job in jobs if names_world(job.scene)):
            refuse_without_truth(job)
        return jobs

    def _check_policies(self) -> list[Spec]:
        """Return the canonical policies without duplicates; raise `InputError` for an invalid policy or override."""
        from activestructure_gym.config import configure
        from activestructure_gym.policies import canonical_policy, make_policy

        for spec in self.policies:  # before anything is imported
            for conditions in self.all_conditions:
                plugin_code_of(Job(Spec(""), spec, 0, conditions=conditions), first_checksum_of)
        list(map(get_protocol, self.conditions.also))
        get_metrics(self.conditions.metrics)
        preset, budget = self.conditions.preset, self.conditions.frame_budget
        given = {} if budget is None else {"frame_budget": budget}
        changes = [{**one.overrides, **given} for one in self.all_conditions]
        _ = self.configurations  # must be valid even where policies replace fields of them
        named = []
        for spec in self.policies:
            if spec.kind == "trajectory":
                followed = TrajectorySpec.of(spec)
                check_effect(spec, [configure(preset, followed.changes(own)) for own in changes])
                named.append(followed.spec)
                continue
            named.append(canonical_policy(spec))
            policy = make_policy(spec)
            native = native_settings_of(policy, self.conditions.setup).overrides()
            try:
                configure(preset, native)
            except InputError as error:
                raise InputError(f"native settings of policy '{spec}': {error}") from error
            features = {"features": tuple(policy.required_features)}
            check_effect(spec, [configure(preset, native | own | features) for own in changes])
        for seed in self.seeds:
            Job(Spec(""), Spec(""), seed)
        return list(dict.fromkeys(named))

    def _warn_without_map(self) -> None:
        from activestructure_gym.config import configure

        if not all(configure(one.preset, one.overrides).mapper.enabled for one in self.all_conditions):
            text = (
                "the map is switched off (mapper.enabled=false): metrics of the map, such as PSNR and C.R., "
                "have no meaning; those of exploration are valid"
            )
            warnings.warn(text, InputWarning, stacklevel=4)

    def _check_scene(self, spec: str, policies: Sequence[Spec]) -> Scene:
        from activestructure_gym.envs.inputs import as_pose
        from activestructure_gym.ground_truth import check_start_pose, ground_truth_of, warn_if_hardly_seen
        from activestructure_gym.volume.config import grid_shape

        scene = scene_as_recorded(spec, self.recorded.get(spec, ""))
        known = ground_truth_of(scene)
        for config in self.configurations:
            grid_shape(scene.bounds, config.volume.voxel_size)
        if not len(known.free_space.start_poses) and self.conditions.start_pose is None:
            raise InputError(f"scene '{spec}' has no place to start from: give one with --start x,y,z,yaw")
        if self.conditions.start_pose is not None:
            widest = max(config.motion.body_radius for config in self.configurations)
            check_start_pose(known, as_pose(self.conditions.start_pose), widest)
        for policy in (policy for policy in policies if policy.kind == "trajectory"):
            given = TrajectorySpec.of(policy)
            for every in dict.fromkeys(config.keyframe_every for config in self.configurations):
                given.resolve(known, every)
            if given.place == PASSIVE and self.conditions.protocol.view_source == "recorded":
                raise InputError(
                    f"'{policy}' maps the views recorded with '{spec}', so they cannot also measure it: leave "
                    "--view-source at free_space"
                )
        warn_if_hardly_seen(known)
        self.conditions.protocol.truth(known)
        for name in self.conditions.also:
            get_protocol(name).truth(known)
        return scene


@dataclass(frozen=True)
class Result:
    """Hold the finished, failed, skipped and missing jobs of a comparison.

    Parameters
    ----------
    runs
        All finished runs, also those of earlier calls.
    failed
        Failed jobs with their errors.
    skipped
        Number of requested jobs that were already finished.
    missing
        Number of unfinished jobs of earlier calls that were not requested now.
    """

    runs: list[Run]
    failed: list[Outcome]
    skipped: int
    missing: int = 0


def jobs_to_resume(
    directory: Path, asked: Comparison | None = None, notify: Callable[[str], None] = lambda _: None
) -> list[Job]:
    """Return the recorded jobs of a comparison, after checking them like those of a new one.

    ``asked`` is the comparison as the user has specified it; plug-in code that it names is trusted. Raise `InputError`
    if there is no record, if a check fails, or if the conditions of ``asked`` differ from the recorded ones.
    """
    recorded = recorded_jobs(directory)
    if not recorded:
        raise InputError(f"there is no comparison in '{directory}' to go on with; say what to compare, or check --out")
    if asked is None:
        refuse_code(recorded, directory / store.COMPARISON)
    prepared = {job.name: job for job in (asked or Comparison.of(recorded)).prepare(notify)}
    # Raises `InputError` if a scene has changed.
    merged(recorded, list(prepared.values()), directory)
    return recorded


def run_comparison(
    jobs: Sequence[Job],
    directory: Path,
    listener: Listener,
    *,
    engine: str = "local",
    limits: Limits | None = None,
    resume: bool = False,
    command: str = "",
    held: int | None = None,
    shard: Shard | None = None,
    notify: Callable[[str], None] = lambda _: None,
) -> Result:
    """Run the jobs that are not finished yet in ``directory``, and read all finished runs.

    Finished jobs are repeated only if their files are damaged or their plug-in code (`archive.plugin_code`) or native
    settings have changed. Jobs of earlier calls stay part of the comparison. Call `check_output` first, then lock the
    directory.

    Parameters
    ----------
    jobs
        Jobs from `Comparison.prepare` or `jobs_to_resume`.
    directory
        Output directory; `archive.store` describes its files.
    listener
        Receives the progress of the jobs.
    engine
        ``"local"``, ``"inline"`` or ``"ray"``.
    limits
        Jobs at a time, minutes per attempt and further attempts. Default: those of `Limits`.
    resume
        Whether the directory may hold a comparison.
    command
        Command of the user, stored in the record.
    held
        The file descriptor from `directory_lock.hold`.
    shard
        Run only this part of the jobs. Other programs may run the rest at the same time: lock with ``shared``.
    notify
        Called with a message about every run that is played again: its files are damaged, or its code has changed.

    Returns
    -------
    Result
        All finished runs, the failed jobs, and the numbers of skipped and missing jobs.

    Raises
    ------
    InputError
        The jobs do not fit those that the directory records (`resuming.merged`), or the engine is unknown.
    """
    chosen, limits = ENGINES.get(engine), limits or Limits()
    recorded = recorded_jobs(directory)
    if recorded and not resume and shard is None:
        raise already_begun(directory)
    everything = merged(recorded, jobs, directory)
    if shard is None:
        temporary.remove_leftovers(directory / completion.JOBS)
        for path in directory.glob(f".{store.COMPARISON}.*"):
            path.unlink(missing_ok=True)
    else:
        jobs = shard.part(jobs)
    asked = {job.name for job in jobs}
    review_finished(everything if shard is None else jobs, asked, directory, notify)
    todo = [job for job in jobs if not completion.is_done(run_directory(directory, job), job)]
    slots = chosen.slots(len(todo), limits) if todo else 1
    with changing(directory, shared=shard is not None):
        before = read_record(directory)
        record = new_record(everything, before, engine=engine, slots=slots, command=command, asked=asked)
        if shard is None or before is None or len(before["jobs"]) < len(everything):
            json_files.write_json(directory / store.COMPARISON, record)
    listener.begin(todo, len(jobs) - len(todo))
    watch = Recording(listener, directory, record, shared=shard is not None)
    if todo:
        chosen.run(todo, directory, watch, limits, keep_open=() if held is None else (held,))
    missing = [
        job
        for job in everything
        if job.name not in asked and not completion.is_done(run_directory(directory, job), job)
    ]
    return Result(finished_runs(directory, everything), watch.failed, len(jobs) - len(todo), len(missing))


def _refuse_twins(jobs: Sequence[Job]) -> None:
    """Raise `InputError` if two scenes have equal content and file name, and so the same run directories."""
    named = dict[str, Job]()
    for job in jobs:
        first = named.setdefault(job.name, job)
        if first is not job:
            raise InputError(
                f"'{first.scene}' and '{job.scene}' are one scene, by content and name: leave one of them out"
            )
