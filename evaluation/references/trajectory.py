"""Parse and load the trajectory that a job follows in place of a policy: ``trajectory:FILE``.

``trajectory:sweep`` is a generated passive sweep. ``trajectory:passive`` is the sequence recorded with the scene, or
the sweep if there is none. If the file is the ``trajectory.npz`` of a run, the keyframes, iteration factors and
decisions of this run are used. With the run's scene, seed and configuration the map is bit-identical.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.envs.reconstruction_env import as_pose
from activestructure_gym.errors import InputError, unknown_name
from activestructure_gym.evaluation.archive.jobs import TRAJECTORY
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
from activestructure_gym.mapping import MAPPERS
from activestructure_gym.motion import PathSegment, recorded_segments, regular_segments
from activestructure_gym.specs import Spec, number_text, typed_options

if TYPE_CHECKING:
    from activestructure_gym.ground_truth import GroundTruth

SWEEP, PASSIVE = "sweep", "passive"  # names used instead of a file
_DIGITS = 8  # number of digits of the file's SHA-256 in a spec
_ROOM = 1e-3  # metres; body radius for given poses, which may be nearer to surfaces than planned ones


@dataclass(frozen=True)
class TrajectorySpec:
    """Hold the place and the options of a trajectory, as given in ``trajectory:PLACE?OPTIONS``."""

    place: str  # a file, or a folder that contains one; or `SWEEP`, `PASSIVE`
    digits: str = ""  # expected first 8 digits of the content's SHA-256; empty: any content
    format: str = "auto"  # format of the file, see `formats`
    axes: str = ""  # axis convention, see `axes`; empty: the usual convention of the format
    inverted: bool = False  # whether poses map world to camera
    start: tuple[float, float, float, float] | None = None  # x, y, z in metres and yaw in degrees of the first pose
    mapper: str = ""  # name of the mapper; empty: the mapper of the configuration

    @classmethod
    def of(cls, spec: Spec) -> TrajectorySpec:
        """Parse a spec such as ``trajectory:FILE?axes=opengl&mapper=splatam``; raise `InputError` for a wrong one."""
        name = spec.place
        place, at, digits = name.rpartition("@")
        if not at or len(digits) != _DIGITS or Path(os.path.expanduser(name)).exists():
            place, digits = name, ""
        options = typed_options("a trajectory", cls, spec.options(f"'{spec}'"), apart=("place", "digits"))
        given = cls(place, digits, **options)
        if given.mapper and given.mapper not in MAPPERS:
            raise unknown_name("mapper", given.mapper, MAPPERS)
        if not given.of_file and set(options) - {"mapper"}:
            raise InputError(f"'{spec}': a {place} is made for the scene and takes the option mapper alone")
        return given

    @property
    def of_file(self) -> bool:
        """Return whether the trajectory is read from a file."""
        return self.place not in (SWEEP, PASSIVE)

    @property
    def frames(self) -> int | None:
        """Return the number of frames of the episode; None if it depends on the scene."""
        if not self.of_file:
            return None
        file, kind = self.file()
        poses = read_poses(file, kind)
        return ResolvedTrajectory(poses, _segments(file, kind, poses, 1)).frames

    @property
    def spec(self) -> Spec:
        """Return the canonical spec: absolute path, first 8 digits of the file's SHA-256, and non-default options.

        Raise `InputError` if the file is missing or has changed.
        """
        if not self.of_file:
            return Spec.joined(TRAJECTORY + self.place, f"mapper={self.mapper}" if self.mapper else "")
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
        return Spec.joined(f"{TRAJECTORY}{file}@{_digits(file)}", query)

    def file(self) -> tuple[Path, str]:
        """Return the path of the file (or folder) and its format; raise `InputError` if its content has changed."""
        file, kind = find_file(self.place, self.format)
        # A symbolic link to a folder is not resolved, because the scan's text file is next to the link.
        file = Path(os.path.abspath(file)) if file.is_dir() else file.resolve()
        if any(letter in str(file) for letter in "?@,&"):
            raise InputError(f"'{file}' has one of ? @ , & in its name, which separate options: rename it")
        if self.digits and _digits(file) != self.digits:
            raise InputError(f"the trajectory '{file}' has changed: expected {self.digits}, found {_digits(file)}")
        return file, kind

    def changes(self, overrides: Mapping[str, Any]) -> dict[str, Any]:
        """Return the changes of the preset by key: ``overrides``, the mapper, and for given poses the body radius."""
        mapper = {"mapper.name": self.mapper} if self.mapper else {}
        room = {} if self.place == SWEEP else {"motion.body_radius": _ROOM}
        return {**room, **overrides, **mapper}

    def resolve(self, truth: GroundTruth, keyframe_every: int) -> ResolvedTrajectory | None:
        """Load the trajectory and check it against the free space of a scene.

        Return None for a sweep, which is generated at the start of an episode. ``keyframe_every`` is the number of
        frames between keyframes where the trajectory has none. Raise `InputError` if the poses do not fit the scene.
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
        return ResolvedTrajectory(poses, _segments(file, kind, poses, keyframe_every), fit.outside)


@dataclass(frozen=True)
class ResolvedTrajectory:
    """Hold the poses of a trajectory in the frame of a scene, divided into segments."""

    poses: np.ndarray  # [T, 4, 4] world_from_camera
    segments: Sequence[PathSegment]  # the poses with their keyframes, one segment per step
    outside: int = 0  # number of poses outside of the scene's free space

    @property
    def frames(self) -> int:
        """Return the number of frames, including the first one."""
        return 1 + sum(len(segment.poses) + segment.lost + segment.stays for segment in self.segments)


def named_trajectory(spec: str) -> Spec:
    """Return the canonical spec of ``trajectory:FILE?options``; raise `InputError` for a wrong one."""
    return TrajectorySpec.of(Spec(spec)).spec


def with_mappers(policies: Sequence[Spec], mappers: Sequence[str]) -> list[Spec]:
    """Return the policies with every trajectory repeated for each mapper by name.

    Raise `InputError` if mappers are given without a trajectory.
    """
    if not mappers:
        return list(policies)
    if not any(policy.kind == "trajectory" for policy in policies):
        raise InputError(
            "--mappers is for trajectories among the policies, such as trajectory:passive; planners map by --set "
            "mapper.name=..."
        )
    return [
        spec
        for policy in policies
        for spec in (
            [replace(TrajectorySpec.of(policy), mapper=name).spec for name in mappers]
            if policy.kind == "trajectory"
            else [policy]
        )
    ]


def _digits(file: Path) -> str:
    """Return the first 8 digits of the SHA-256 of a trajectory's file or folder."""
    if file.is_dir():  # one file per pose
        whole = hashlib.sha256()
        for one in (*pose_files(file), *filter(Path.is_file, [scan_text(file)])):
            whole.update(f"{one.name} {hashlib.sha256(one.read_bytes()).hexdigest()}\n".encode())
        return whole.hexdigest()[:_DIGITS]
    with open(file, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()[:_DIGITS]


def _segments(file: Path, kind: str, poses: np.ndarray, keyframe_every: int) -> list[PathSegment]:
    arrays = arrays_of(file) if kind == "npz" else {}
    if not {"legs", "keyframes", "keyframe_rounds"} <= arrays.keys():
        return regular_segments(poses, keyframe_every)
    try:
        return recorded_segments(arrays | {"world_from_camera": poses})
    except (ValueError, IndexError) as error:
        raise InputError(f"'{file}' is damaged: {error}") from error
