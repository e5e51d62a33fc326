"""Who follows a given trajectory in place of a policy: ``trajectory:FILE`` in the jobs of a comparison.

``trajectory:sweep`` is a generated passive sweep, ``trajectory:passive`` the sequence that was recorded with the scene,
or the sweep where there is none. The poses go through the sensor, the map and the protocols of every other run, frame
by frame. Where a file is the ``trajectory.npz`` of a run, keyframes, rounds and decisions are that run's, and so is the
map, to the last bit, on the run's scene, seed and configuration.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.config import configure
from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.envs.reconstruction_env import as_pose
from activestructure_gym.errors import InputError, unknown_name
from activestructure_gym.evaluation.archive.jobs import TRAJECTORY, Job, is_trajectory
from activestructure_gym.evaluation.trajectories.axes import USUAL, begun_at, in_our_axes
from activestructure_gym.evaluation.trajectories.fit import checked
from activestructure_gym.evaluation.trajectories.formats import (
    QUATERNIONS,
    arrays_of,
    find_file,
    pose_files,
    read_poses,
    scan_text,
)
from activestructure_gym.evaluation.trajectories.motion import motion_report
from activestructure_gym.mapping import MAPPERS
from activestructure_gym.motion import PathSegment, recorded_segments, regular_segments
from activestructure_gym.specs import Spec, number_text, typed_options

if TYPE_CHECKING:
    from activestructure_gym.ground_truth import GroundTruth

SWEEP, PASSIVE = "sweep", "passive"  # in place of a file
_DIGITS = 8  # of the file's SHA-256, in its name
_ROOM = 1e-3  # metres that must be free around the start of a camera that has been there


@dataclass(frozen=True)
class TrajectorySpec:
    """A trajectory as it is asked for."""

    place: str  # a file, or a folder that has one; or `SWEEP`, `PASSIVE`
    digits: str = ""  # of the content that is meant
    kind: str = "auto"  # format, see `formats`
    axes: str = ""  # convention, see `axes`; the format's usual one if not given
    inverted: bool = False  # whether poses map world to camera
    start: tuple[float, float, float, float] | None = None  # x, y, z metres, yaw degrees, of the first pose
    mapper: str = ""  # recipe that maps it; the configuration's if not given

    @classmethod
    def of(cls, spec: str) -> TrajectorySpec:
        """What ``trajectory:FILE?axes=opengl&mapper=splatam`` asks for; raises `InputError`."""
        parsed = Spec.of(spec)
        name = parsed.place
        place, at, digits = name.rpartition("@")
        if not at or len(digits) != _DIGITS or Path(os.path.expanduser(name)).exists():
            place, digits = name, ""
        texts = parsed.options(f"'{spec}'")
        options = typed_options("a trajectory", _options, texts)
        given = cls(place, digits, **{"kind" if key == "format" else key: value for key, value in options.items()})
        if given.mapper and given.mapper not in MAPPERS:
            raise unknown_name("mapper", given.mapper, MAPPERS)
        if not given.of_file and set(options) - {"mapper"}:
            raise InputError(f"'{spec}': a {place} is made for the scene and takes the option mapper alone")
        return given

    @property
    def of_file(self) -> bool:
        """Whether it stands in a file."""
        return self.place not in (SWEEP, PASSIVE)

    @property
    def frames(self) -> int | None:
        """Frames that it costs, whatever the scene; None where the scene decides."""
        if not self.of_file:
            return None
        file, kind = self.file()
        poses = read_poses(file, kind)
        return ResolvedTrajectory(poses, _legs(file, kind, poses, 1)).frames

    @property
    def spec(self) -> str:
        """The one text for it: absolute place, the first digits of its content, and what is not usual.

        Raises `InputError` where the file is not there or another one than is meant.
        """
        if not self.of_file:
            return str(Spec(TRAJECTORY + self.place, f"mapper={self.mapper}" if self.mapper else ""))
        file, kind = self.file()
        usual = USUAL.get(kind, "opencv")
        options = {
            "axes": self.axes if self.axes not in ("", usual) else "",
            "format": kind if kind != find_file(file)[1] else "",
            "inverted": "true" if self.inverted else "",
            "mapper": self.mapper,
            "start": ",".join(map(number_text, self.start or ())),
        }
        query = "&".join(f"{key}={value}" for key, value in options.items() if value)
        return str(Spec(f"{TRAJECTORY}{file}@{_digits(file)}", query))

    def file(self) -> tuple[Path, str]:
        """The file and its format, checked against the digits."""
        file, kind = find_file(self.place, self.kind)
        file = Path(os.path.abspath(file)) if file.is_dir() else file.resolve()  # a linked folder keeps its scan
        if any(letter in str(file) for letter in "?@,&"):
            raise InputError(f"'{file}' has one of ? @ , & in its name, which separate options: rename it")
        if self.digits and _digits(file) != self.digits:
            raise InputError(f"the trajectory '{file}' has changed: expected {self.digits}, found {_digits(file)}")
        return file, kind

    def changes(self, overrides: Mapping[str, Any]) -> dict[str, Any]:
        """All changes of the preset's fields where ``overrides`` were asked for."""
        mapper = {"mapper.name": self.mapper} if self.mapper else {}
        room = {} if self.place == SWEEP else {"motion.body_radius": _ROOM}
        return {**room, **overrides, **mapper}

    def course(self, truth: GroundTruth, keyframe_every: int) -> ResolvedTrajectory | None:
        """Its legs in a scene, None for a sweep, which depends on the start of an episode.

        Raises `InputError` where a camera cannot have been there.
        """
        if self.place == PASSIVE and truth.scene.evaluation_views is not None:
            poses = truth.scene.evaluation_views.world_from_camera
            fit = checked(
                truth.free_space.clearance_at, poses, poses, "opencv", False, f"recorded' in '{truth.scene.name}"
            )
            return ResolvedTrajectory(poses, regular_segments(poses, keyframe_every), fit.outside)
        if not self.of_file:
            return None
        file, kind = self.file()
        written = read_poses(file, kind)
        axes = self.axes or USUAL.get(kind, "opencv")
        poses = in_our_axes(written, axes, inverted=self.inverted)
        if self.start is not None:
            poses = begun_at(poses, as_pose(self.start))
        name = f"{file.name}' in '{truth.scene.name}"
        clearance_at, quaternions = truth.free_space.clearance_at, kind in QUATERNIONS
        fit = checked(clearance_at, written, poses, axes, self.inverted, name, quaternions=quaternions)
        return ResolvedTrajectory(poses, _legs(file, kind, poses, keyframe_every), fit.outside)


@dataclass(frozen=True)
class ResolvedTrajectory:
    """A trajectory in a scene."""

    poses: np.ndarray  # [T, 4, 4] world_from_camera
    legs: Sequence[PathSegment]  # what is done along them
    outside: int = 0  # poses that are not in the scene's free space

    @property
    def frames(self) -> int:
        """Frames that it costs, the first one included."""
        return 1 + sum(len(leg.poses) + leg.lost + leg.stays for leg in self.legs)


def named_trajectory(spec: str) -> str:
    """The one text for ``trajectory:FILE?options``; raises `InputError`."""
    return TrajectorySpec.of(spec).spec


def with_mappers(policies: Sequence[str], mappers: Sequence[str]) -> list[str]:
    """The policies, every trajectory among them once for each mapper; raises `InputError` where there is none."""
    if not mappers:
        return list(policies)
    if not any(map(is_trajectory, policies)):
        raise InputError(
            "--mappers is for trajectories among the policies, such as trajectory:passive; planners map by --set "
            "mapper.name=..."
        )
    return [
        spec
        for policy in policies
        for spec in (
            [replace(TrajectorySpec.of(policy), mapper=name).spec for name in mappers]
            if is_trajectory(policy)
            else [policy]
        )
    ]


def _options(
    format: str = "auto",
    axes: str = "",
    inverted: bool = False,
    start: tuple[float, float, float, float] | None = None,
    mapper: str = "",
) -> None:
    """The options of a trajectory, for `typed_options`."""


def _digits(file: Path) -> str:
    if file.is_dir():  # of poses, a file each
        whole = hashlib.sha256()
        for one in (*pose_files(file), *filter(Path.is_file, [scan_text(file)])):
            whole.update(f"{one.name} {hashlib.sha256(one.read_bytes()).hexdigest()}\n".encode())
        return whole.hexdigest()[:_DIGITS]
    with open(file, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()[:_DIGITS]


def _legs(file: Path, kind: str, poses: np.ndarray, keyframe_every: int) -> list[PathSegment]:
    arrays = arrays_of(file) if kind == "npz" else {}
    if not {"legs", "keyframes", "keyframe_rounds"} <= arrays.keys():
        return regular_segments(poses, keyframe_every)
    try:
        return recorded_segments(arrays | {"world_from_camera": poses})
    except (ValueError, IndexError) as error:
        raise InputError(f"'{file}' is damaged: {error}") from error


class TrajectoryEnv(ReconstructionEnv):
    """An environment in which every step, whatever the action, is the next leg of a trajectory."""

    course: ResolvedTrajectory

    def __init__(self, course: ResolvedTrajectory | None, truth: GroundTruth, **options: Any) -> None:
        given = {} if course is None else {"start_pose": course.poses[0]}
        super().__init__(**options | given, scene=truth)
        self._given, self._truth = course, truth
        self._next = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin where the trajectory begins; a sweep begins where any episode would."""
        self._next = 0
        begun = super().reset(seed=seed, options=options)
        self.course = self._given or self._sweep()
        return begun

    def _as_start(self, value: Sequence[float] | np.ndarray) -> np.ndarray:  # [4, 4]
        return as_pose(value)  # a camera in somebody's hand rolls

    def _sweep(self) -> ResolvedTrajectory:
        from activestructure_gym.evaluation.references.sweep import sweep

        config = self.config
        poses = sweep(self._truth.free_space, self.reconstruction.pose, config.frame_budget, config.motion)
        return ResolvedTrajectory(poses, regular_segments(poses, config.keyframe_every))

    def step(self, action: Any) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Follow the next leg; terminates with the last one."""
        self._access.check_open("step")
        legs = self.course.legs
        leg = legs[self._next] if self._next < len(legs) else PathSegment(self.course.poses[:0], ())
        self._next += 1
        observation, reward, _, truncated, info = self._outcome(self.reconstruction.follow(leg), invalid=False)
        return observation, reward, self._next >= len(legs), truncated, info


class TrajectoryPolicy:
    """In place of a policy: decides nothing."""

    def reset(self, seed: int) -> None:
        """Nothing is drawn."""

    def act(self, observation: dict[str, np.ndarray]) -> int:
        """Any row: `TrajectoryEnv` takes none."""
        return 0

    def trace(self) -> dict[str, Any]:
        """Nothing was weighed."""
        return {}


def trajectory_policy_and_env(job: Job, known: GroundTruth) -> tuple[TrajectoryPolicy, TrajectoryEnv]:
    """Who follows the trajectory of a job, and its env."""
    given = TrajectorySpec.of(job.policy)
    changes = given.changes(job.conditions.overrides)
    config = configure(job.conditions.preset, changes)
    resolved = given.course(known, config.keyframe_every)
    env = TrajectoryEnv(resolved, known, features=(), **job.conditions.env_options(changes))
    return TrajectoryPolicy(), env


def followed_metrics(env: TrajectoryEnv) -> dict[str, float]:
    """How the trajectory moved beside the limits of planners, and how many of its poses stand in something."""
    motion, executed = env.config.motion, np.stack(env.reconstruction.trajectory)
    told = motion_report(executed, max_step_m=motion.max_step_m, max_turn_deg=motion.max_turn_deg)
    return {**told, "poses_outside": env.course.outside}
