"""Infer the up axis from the geometry: many files do not state it, and some state a wrong one.

An indoor scene has a floor and a ceiling: two level surfaces at the distance of a room's height. They have more area
than the walls along any other axis, and are usually at the ends of the shortest side of the bounding box. Furniture is
on the floor, so geometry between floor and ceiling is mostly near the floor. Free vertical lines, which meet no
surface, begin on furniture below and end at the bare ceiling above. If this evidence is weak or contradictory, there is
no verdict. Winding is ignored: half of all files have it inverted.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from activestructure_gym.errors import InputError

UpAxis = Literal["x", "y", "z", "-x", "-y", "-z"]
UP_AXES: tuple[UpAxis, ...] = get_args(UpAxis)
_ENDS: dict[str, tuple[UpAxis, UpAxis]] = {"x": ("x", "-x"), "y": ("y", "-y"), "z": ("z", "-z")}
CEILING_HEIGHTS = (1.9, 6.0)  # metres, floor to ceiling

# Number of points on the surface, and of columns per side of their grid. They give hundreds of free lines in a few tens
# of milliseconds.
_POINTS = 40_000
_COLUMNS = 22
_FACES_AT_ONCE = 1 << 18  # number of faces whose corners are converted at a time
# "The side" is the side of the bounding box along the tested axis.
_LEVELS = 4096  # number of steps of the height within a column

_MIN_GAP = 0.3  # minimum length of a free line, as a fraction of the side; shorter ones are inside furniture and walls
_MIN_LINES = 0.15  # minimum fraction of the columns with a free line in a room
_NEAR = 0.04  # fraction of the side; points this close to floor or ceiling belong to it
_END = 0.12  # fraction of the side at which the ends are compared; frames and sills extend up to this far
# Minimum cosines between a normal and the axis, for walls, floors and ceilings, and for any supporting surface.
_FACING, _LEVEL = 0.98, 0.7

# Required evidence; values for scenes of many sources are in tests/scenes/loaders/test_upright.py.
_STANDS_OUT = 1.3  # minimum surface per length of the vertical axis, relative to the next axis
_CLEARLY_OUT = 2.2  # the same to exclude other axes; empty rooms narrower than high have up to 1.9 across
_TELLS = 0.45  # minimum |evidence| for one end to be the floor; furnished rooms have 1.2 to 2.4, empty ones -0.1 to 0.8
_CLEAR = 1.0  # minimum |evidence| to exclude the other end
_MIN_BETWEEN = 0.015  # minimum fraction of the level surface between floor and ceiling (furniture) for any evidence


@dataclass(frozen=True)
class Verdict:
    """Hold the up axis inferred from the geometry."""

    up: UpAxis | None  # the inferred axis, None if undecided
    possible: tuple[UpAxis, ...]  # axes that are not clearly excluded
    reason: str  # the evidence, as the end of a sentence


@dataclass(frozen=True)
class _Side:
    """Hold statistics of the geometry along one axis, with its low end called floor.

    Heights and distances are fractions of the side of the bounding box along the axis. A line is a free line: a segment
    parallel to the axis that meets no surface.
    """

    length: float  # metres
    surface: float  # fraction of all surface that faces along the axis
    missing: float  # fraction of surface missing to close an open end, as in scans without a ceiling
    lines: float  # fraction of the columns with a free line
    floor: float = 0.0  # height where most lines begin
    ceiling: float = 1.0  # height where most lines end
    standing: float = 0.0  # mean height above the floor at which lines begin
    hanging: float = 0.0  # mean distance below the ceiling at which lines end
    between: float = 0.0  # fraction of the level surface that is neither floor nor ceiling
    lower: float = 0.5  # fraction of the level surface in between that is in the lower half
    middle: float = 0.5  # mean height of all surface between floor and ceiling, 0 = floor, 1 = ceiling

    @property
    def height(self) -> float:  # metres
        return (self.ceiling - self.floor) * self.length

    @property
    def surface_per_length(self) -> float:
        return (self.surface + self.missing) / self.length

    @property
    def is_room_high(self) -> bool:
        return self.lines >= _MIN_LINES and CEILING_HEIGHTS[0] <= self.height <= CEILING_HEIGHTS[1]

    @property
    def floor_is_low(self) -> float:
        """Return the evidence, about -3 to 3, that the low end is the floor; negative if the high end is the floor."""
        if self.between < _MIN_BETWEEN:
            return 0.0
        # The term 0.03 reduces the weight of small heights: a lintel hangs down as far as a single chair is high.
        lines = (self.standing - self.hanging) / (self.standing + self.hanging + 0.03)
        return lines + (2.0 * self.lower - 1.0) + 4.0 * (0.5 - self.middle)


def which_way_is_up(vertices: np.ndarray, faces: np.ndarray) -> Verdict:
    """Infer the up axis of triangles ``faces`` [F, 3] over ``vertices`` [V, 3] in metres, in file axes."""
    points, normals = surface_points(vertices, faces)
    if not len(points) or not np.ptp(points, axis=0).all():
        return Verdict(None, UP_AXES, "the mesh is flat")
    sides = {name: _side(points, normals, axis) for axis, name in enumerate("xyz")}
    axis = max(sides, key=lambda name: sides[name].surface_per_length)
    side, others = sides[axis], {name: other for name, other in sides.items() if name != axis}
    if not _stands_out(side, others.values()):
        surfaces = ", ".join(f"{100 * side.surface:.0f}" for side in sides.values())
        lengths = " x ".join(f"{side.length:.2f}" for side in sides.values())
        return Verdict(
            None,
            UP_AXES,
            f"floor and ceiling are not clear along any axis (facing x, y, z: {surfaces} % of the surface; sides "
            f"{lengths} m)",
        )
    room = (
        f"floor and ceiling lie {side.height:.2f} m apart along {axis}, the shortest side, with "
        f"{100 * side.surface:.0f} % of the surface"
    )
    evidence = side.floor_is_low
    if abs(evidence) < _TELLS:
        near = side.surface_per_length / _CLEARLY_OUT
        possible = (axis, *(name for name, other in others.items() if other.surface_per_length > near))
        reason = f"{room}, but the surfaces between them do not show which is the floor"
        return Verdict(None, _both_ends(possible), reason)
    up, floor = (_ENDS[axis][0], f"-{axis}") if evidence > 0 else (_ENDS[axis][1], f"+{axis}")
    share = side.lower if evidence > 0 else 1.0 - side.lower
    return Verdict(
        up,
        (up,) if abs(evidence) >= _CLEAR else _both_ends((axis,)),
        f"{room}, and {100 * share:.0f} % of the level surface between them is in the half towards {floor}",
    )


def _stands_out(side: _Side, others: Collection[_Side]) -> bool:
    """Return whether ``side`` belongs to the axis of floor and ceiling, compared with the two other sides."""
    return (
        side.is_room_high
        and side.length <= min(other.length for other in others)
        and side.surface_per_length >= _STANDS_OUT * max(other.surface_per_length for other in others)
    )


def _both_ends(axes: Collection[str]) -> tuple[UpAxis, ...]:
    return tuple(end for axis in sorted(axes) for end in _ENDS[axis])


@dataclass(frozen=True)
class DeclaredUp:
    """Hold the up axis that the file or its format declares; it is used unless the user gives another one."""

    up: str
    words: str  # the reason, as in "y is up in glTF"
    explicit: bool = False  # set by the file's author; False: the format's rule, or an exporter's default


def choose_up(
    path: Path,
    vertices: np.ndarray,  # [V, 3] metres, file axes
    faces: np.ndarray,  # [F, 3]
    *,
    given: str | None,  # the user's choice: one of `UP_AXES`, "auto", or None
    declared: DeclaredUp,
) -> tuple[str, list[str]]:
    """Return the file's up axis, and a list with at most one message on the choice.

    An explicit choice for this file is kept. An axis that follows from the format alone is kept unless the geometry
    clearly contradicts it; then, and if "auto" is undecided, it raises `InputError`.
    """
    if given is None and declared.up not in UP_AXES:
        raise InputError(
            f"'{path}': '{declared.up}' is up {declared.words}, expected one of {', '.join(UP_AXES)}; give it, for "
            "example up=y or up=z"
        )
    verdict = which_way_is_up(vertices, faces)
    if given == "auto":
        if verdict.up is None:
            raise InputError(
                f"'{path}': up=auto cannot determine the up axis: {verdict.reason}; give it, for example up=y or up=z"
            )
        return verdict.up, [f"up={verdict.up} by the geometry: {verdict.reason}"]
    up, choice = (declared.up, f"{declared.up} is up {declared.words}") if given is None else (given, f"up={given}")
    if up not in verdict.possible:
        told = (verdict.up,) if verdict.up else verdict.possible
        if given is None and not declared.explicit:
            raise InputError(
                f"'{path}': {choice}, but the geometry says {' or '.join(told)}: {verdict.reason}; give "
                f"{' or '.join(f'up={axis}' for axis in told)} to follow the geometry, or up={up} to insist"
            )
        return up, [f"{choice}, though the geometry says {' or '.join(told)}: {verdict.reason}"]
    if given is None and not declared.explicit and verdict.up != up:
        rather = "cannot tell" if verdict.up is None else f"rather says {verdict.up}"
        return up, [f"{choice}; the geometry {rather}: {verdict.reason}"]
    return up, []


def surface_points(
    vertices: np.ndarray, faces: np.ndarray, count: int = _POINTS
) -> tuple[np.ndarray, np.ndarray]:  # [N, 3], [N, 3]
    """Return ``count`` points spread evenly over the surface, and their unit normals; no random numbers are used.

    Points are distributed over triangles by area, and follow the R2 sequence within triangles.
    """
    doubled = np.concatenate([np.zeros(0), *(_lengths(_normals(vertices, part)) for part in _in_parts(faces))])
    total = np.cumsum(doubled)
    if not len(total) or not total[-1] > 0:
        return np.zeros((0, 3)), np.zeros((0, 3))
    chosen = faces[np.searchsorted(total, (np.arange(count) + 0.5) / count * total[-1])]
    u, v = np.modf(np.arange(count)[:, None] * (0.7548776662466927, 0.5698402909980532))[0].T
    outside = u + v > 1.0
    u, v = np.where(outside, 1.0 - u, u), np.where(outside, 1.0 - v, v)
    weights = np.stack([1.0 - u - v, u, v], axis=1)
    normals = _normals(vertices, chosen)
    return np.einsum("nc,nci->ni", weights, vertices[chosen]), normals / _lengths(normals)[:, None]


def _in_parts(faces: np.ndarray) -> Iterator[np.ndarray]:
    return (faces[first : first + _FACES_AT_ONCE] for first in range(0, len(faces), _FACES_AT_ONCE))


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:  # [F, 3], twice the area in length
    first, second, third = (vertices[faces[:, corner]].astype(np.float64) for corner in range(3))
    return np.cross(second - first, third - first)


def _lengths(vectors: np.ndarray) -> np.ndarray:  # [N, 3] -> [N]
    return np.sqrt(np.einsum("ni,ni->n", vectors, vectors))


def _side(points: np.ndarray, normals: np.ndarray, axis: int) -> _Side:
    low, length = points.min(axis=0), np.ptp(points, axis=0)
    place = (points - low) / length  # [N, 3] 0..1
    height = place[:, axis]
    across = np.minimum((np.delete(place, axis, axis=1) * _COLUMNS).astype(np.int32), _COLUMNS - 1)
    column = across[:, 0] * _COLUMNS + across[:, 1]
    begin, end, columns = _free_lines(column, height)
    facing = np.abs(normals[:, axis])
    seen = {
        "length": float(length[axis]),
        "surface": float(np.mean(facing > _FACING)),
        "missing": _missing_end(height[facing > _FACING]) / len(height),
        "lines": len(begin) / columns,
    }
    if not len(begin):
        return _Side(**seen)
    floor, ceiling = _most_common(begin), _most_common(end)
    level = facing > _LEVEL
    between = (height > floor + _NEAR) & (height < ceiling - _NEAR)
    in_between, level_between = height[between], height[between & level]
    if not len(level_between):
        return _Side(**seen, floor=floor, ceiling=ceiling)
    return _Side(
        **seen,
        floor=floor,
        ceiling=ceiling,
        standing=float(np.maximum(begin - floor, 0.0).mean()),
        hanging=float(np.maximum(ceiling - end, 0.0).mean()),
        between=len(level_between) / np.count_nonzero(level),
        lower=float(np.mean(level_between < 0.5 * (floor + ceiling))),
        middle=float((in_between.mean() - floor) / (ceiling - floor)),
    )


def _missing_end(heights: np.ndarray) -> int:
    """Return the number of points missing at one end of the side; 0 unless it has almost none.

    ``heights`` are the points that face along the axis. The result is the difference of the numbers at both ends.
    """
    low, high = np.count_nonzero(heights < _END), np.count_nonzero(heights > 1.0 - _END)
    return int(abs(high - low)) if min(low, high) < 0.1 * max(low, high) else 0


def _free_lines(column: np.ndarray, height: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Return begin and end of the longest free line of every column that has one, and the number of occupied columns.

    ``column`` and ``height`` [N] (0..1) are of the surface points. Both ends of the side count as surface, so without a
    ceiling a line extends to the end of the side.
    """
    held = np.unique(column).astype(np.int32)
    levels = np.minimum((height * _LEVELS).astype(np.int32), _LEVELS - 1)
    keys = np.concatenate([column.astype(np.int32) * _LEVELS + levels, held * _LEVELS, held * _LEVELS + _LEVELS - 1])
    keys.sort()
    of, at = np.divmod(keys, _LEVELS)
    gap = np.where(of[1:] == of[:-1], at[1:] - at[:-1], 0)
    first = np.searchsorted(of[1:], held)  # columns are sorted: the first gap of each
    longest = np.maximum.reduceat(gap, first)
    of_longest = np.repeat(longest, np.diff(np.append(first, len(gap))))
    is_longest = np.flatnonzero((gap == of_longest) & (gap >= _MIN_GAP * _LEVELS))
    _, chosen = np.unique(of[is_longest], return_index=True)
    line = is_longest[chosen]
    return at[line] / _LEVELS, at[line + 1] / _LEVELS, len(held)


def _most_common(places: np.ndarray) -> float:
    """Return the centre of the window of 0.02 that contains most of ``places``, which are in 0..1."""
    counts = np.histogram(places, bins=100, range=(0.0, 1.0))[0]
    return (int((counts[:-1] + counts[1:]).argmax()) + 1) / 100
