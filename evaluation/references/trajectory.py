"""Parse and load the trajectory that a job follows in place of a policy: ``trajectory:FILE``.

``trajectory:sweep`` is a generated passive sweep. ``trajectory:passive`` is the sequence recorded with the scene, or
the sweep if there is none. If the file is the ``trajectory.npz`` of a run, the keyframes, iteration factors and
decisions of this run are used. With the run's scene, seed and configuration the map is bit-identical.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.envs.inputs import as_pose
from activestructure_gym.errors import InputError, unknown_name
from activestructure_gym.evaluation.archive.jobs import TRAJECTORY
from activestructure_gym.evaluation.trajectories.alignment import matched, trajectory_errors, umeyama
from activestructure_gym.evaluation.trajectories.axes import USUAL, begun_at, in_our_axes
from activestructure_gym.evaluation.trajectories.fit import checked
from activestructure_gym.evaluation.trajectories.formats import (
    QUATERNIONS,
    RecordedPoses,
    arrays_of,
    find_file,
    pose_files,
    read_recorded,
    scan_text,
)
from activestructure_gym.evaluation.trajectories.keyframes import every_of, listed_poses
from activestructure_gym.mapping import MAPPERS
from activestructure_gym.motion import PathSegment, recorded_segments, regular_segments, segments_at
from activestructure_gym.specs import Spec, number_text, typed_options

if TYPE_CHECKING:
    from activestructure_gym.ground_truth import GroundTruth

SWEEP, PASSIVE = "sweep", "passive"  # names used instead of a file
ALIGNMENTS = ("se3", "sim3")  # rotation and translation, without and with scale
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
    keyframes: str = ""  # poses to map: "all", every N-th, or a file of indices or time stamps; empty: as configured
    reference: str = ""  # file of the reference trajectory, in the frame of the scene; empty: none
    align: str = ""  # one of `ALIGNMENTS`, by which the trajectory is moved to the reference; empty: not moved

    @classmethod
    def of(cls, spec: Spec) -> TrajectorySpec:
        """Parse a spec such as ``trajectory:FILE?axes=opengl&mapper=splatam``; raise `InputError` for a wrong one."""
        place, digits = _split(spec.place)
        options = typed_options("a trajectory", cls, spec.options(f"'{spec}'"), apart=("place", "digits"))
        given = cls(place, digits, **options)
        if given.mapper and given.mapper not in MAPPERS:
            raise unknown_name("mapper", given.mapper, MAPPERS)
        if not given.of_file and set(options) - {"mapper"}:
            raise InputError(f"'{spec}': a {place} is made for the scene and takes the option mapper alone")
        given.check()
        return given

    def check(self) -> None:
        """Raise `InputError` if the options that place the trajectory do not fit each other."""
        if self.align and self.align not in ALIGNMENTS:
            raise unknown_name("alignment", self.align, ALIGNMENTS)
        if self.align and not self.reference:
            raise InputError("an alignment needs the trajectory to align to: give a reference as well")
        if self.align and self.start is not None:
            raise InputError("an alignment and a start both place the trajectory: give one of them")

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
        recorded = read_recorded(file, kind)
        return ResolvedTrajectory(recorded.poses, self._segments(file, kind, recorded, 1)).frames

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
            "align": self.align,
            "axes": self.axes if self.axes not in ("", usual) else "",
            "format": kind if kind != find_file(file)[1] else "",
            "inverted": "true" if self.inverted else "",
            "keyframes": self._keyframes,
            "mapper": self.mapper,
            "reference": _with_digits(self._reference.file()[0]) if self.reference else "",
            "start": ",".join(map(number_text, self.start or ())),
        }
        query = "&".join(f"{key}={value}" for key, value in options.items() if value)
        return Spec.joined(TRAJECTORY + _with_digits(file), query)

    @property
    def _keyframes(self) -> str:
        """Return the canonical option ``keyframes``; a file has an absolute path and digits of its checksum."""
        if not self.keyframes:
            return ""
        every = every_of(self.keyframes)
        return str(every) if every else _with_digits(_listing(self.keyframes))

    def file(self) -> tuple[Path, str]:
        """Return the path of the file (or folder) and its format; raise `InputError` if its content has changed."""
        file, kind = find_file(self.place, self.format)
        # A symbolic link to a folder is not resolved, because the scan's text file is next to the link.
        file = Path(os.path.abspath(file)) if file.is_dir() else file.resolve()
        _check_digits(file, self.digits)
        return file, kind

    @property
    def _reference(self) -> TrajectorySpec:
        """Return the reference trajectory, which has the usual axes of its format."""
        given = TrajectorySpec(*_split(self.reference))
        if not given.of_file:
            raise InputError(f"a reference trajectory is a file of poses, got '{self.reference}'")
        return given

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
        recorded = read_recorded(file, kind)
        written = recorded.poses
        axes = self.axes or USUAL.get(kind, "opencv")
        poses = in_our_axes(written, axes, inverted=self.inverted)
        errors: dict[str, float] = {}
        if self.start is not None:
            poses = begun_at(poses, as_pose(self.start))
        if self.reference:
            poses, errors = self._compared(poses, recorded.stamps)
        name = f"{file.name}' ({kind}) in '{truth.scene.name}"
        clearance_at, quaternions = truth.free_space.clearance_at, kind in QUATERNIONS
        fit = checked(clearance_at, written, poses, axes, self.inverted, name, quaternions=quaternions)
        segments = self._segments(file, kind, replace(recorded, poses=poses), keyframe_every)
        return ResolvedTrajectory(poses, segments, fit.outside, errors)

    def _compared(self, poses: np.ndarray, stamps: np.ndarray | None) -> tuple[np.ndarray, dict[str, float]]:
        """Return the poses [T, 4, 4], aligned to the reference if asked, and their errors (see `trajectory_errors`)."""
        file, kind = self._reference.file()
        found = read_recorded(file, kind)
        reference = in_our_axes(found.poses, USUAL.get(kind, "opencv"))
        ours, theirs = matched(len(poses), stamps, len(reference), found.stamps)
        scale = {}
        if self.align:
            moved = umeyama(poses[ours, :3, 3], reference[theirs, :3, 3], with_scale=self.align == "sim3")
            poses, scale = moved.moved(poses), {"align_scale": moved.scale}
        return poses, trajectory_errors(poses[ours], reference[theirs]) | scale

    def _segments(self, file: Path, kind: str, recorded: RecordedPoses, keyframe_every: int) -> Sequence[PathSegment]:
        """Return the segments with the keyframes of the option, of a run, or every ``keyframe_every``-th."""
        poses = recorded.poses
        if not self.keyframes:
            return _segments(file, kind, poses, keyframe_every)
        every = every_of(self.keyframes)
        if every is not None:
            return regular_segments(poses, every)
        return segments_at(poses, listed_poses(_listing(self.keyframes), len(poses), recorded.stamps))


@dataclass(frozen=True)
class ResolvedTrajectory:
    """Hold the poses of a trajectory in the frame of a scene, divided into segments."""

    poses: np.ndarray  # [T, 4, 4] world_from_camera
    segments: Sequence[PathSegment]  # the poses with their keyframes, one segment per step
    outside: int = 0  # number of poses outside of the scene's free space
    errors: Mapping[str, float] = field(default_factory=dict)  # to the reference trajectory; empty without one

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


def _split(text: str) -> tuple[str, str]:
    """Split ``FILE@DIGITS`` into the file and the digits of its checksum, which are "" if none are given."""
    place, at, digits = text.rpartition("@")
    if not at or len(digits) != _DIGITS or Path(os.path.expanduser(text)).exists():
        return text, ""
    return place, digits


def _check_digits(file: Path, digits: str) -> None:
    """Raise `InputError` if the name of a file has characters of a spec, or if its checksum is not ``digits``."""
    if any(letter in str(file) for letter in "?@,&"):
        raise InputError(f"'{file}' has one of ? @ , & in its name, which separate options: rename it")
    if digits and _digits(file) != digits:
        raise InputError(f"the file '{file}' has changed: expected {digits}, found {_digits(file)}")


def _listing(text: str) -> Path:
    """Return the path of a list of keyframes, ``FILE`` or ``FILE@DIGITS``; raise `InputError` if it has changed."""
    place, digits = _split(text)
    file = Path(os.path.expanduser(place)).resolve()
    if not file.is_file():
        raise InputError(f"there is no list of keyframes '{place}'; give all, a number from 1, or a file")
    _check_digits(file, digits)
    return file


def _with_digits(file: Path) -> str:
    """Return ``FILE@DIGITS``, a path with the first digits of the file's checksum."""
    return f"{file}@{_digits(file)}"


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
