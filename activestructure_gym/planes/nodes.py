"""Represent one plane of the scene: a node of the Plane Scene Graph."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from activestructure_gym.planes.detection import PlaneSegment
from activestructure_gym.planes.detection_kernels import MOMENTS
from activestructure_gym.planes.surface import Patch, SurfaceGrid
from activestructure_gym.planes.surface_kernels import average_plane
from activestructure_gym.planes.vectors import distance, length

_SECOND = np.array([[4, 5, 6], [5, 7, 8], [6, 8, 9]])  # places of the 3 x 3 matrix of second moments in the ten moments


class PlaneNode:
    """Represent a plane as observed by all keyframes so far (Sec. 3.2).

    Its points x satisfy ``normal . x + offset = 0`` in metres. The normal points to the side from which the plane is
    observed, so the two faces of a thin wall are two planes.
    """

    def __init__(self, node_id: int, segment: PlaneSegment, axes: np.ndarray, *, cell: float, window: int) -> None:
        self.id = node_id  # unique and never reused
        self.normal = segment.normal.copy()  # [3] unit, world
        self.offset = segment.offset  # metres
        self.surface = SurfaceGrid(segment.centroid, axes, cell)
        # [3] metres, world; moments are taken about this point, for numerical precision.
        self.anchor = segment.centroid.copy()
        self.moments = np.zeros(MOMENTS)
        self.keyframes = 0  # bit t is set if keyframe t observed the plane
        self.normals: dict[int, np.ndarray] = {}  # keyframe -> [3] unit, observed normal; the last ``window`` keyframes
        self._window = window
        self.shift = np.inf  # metres that the centroid moved at the last update; inf before the first
        self.area_change = np.inf  # relative change of the area at the last update

    @property
    def observations(self) -> int:
        """Return o_i, the number of keyframes that observed the plane."""
        return self.keyframes.bit_count()

    @property
    def area(self) -> float:
        """Return a_i, the area of the seen surface in m^2."""
        return self.surface.area

    @property
    def centroid(self) -> np.ndarray:  # [3] world
        """Return the centroid of the seen surface in metres."""
        return self.surface.centroid

    @property
    def row(self) -> np.ndarray:  # [7]
        """Return normal, offset and centroid in one array, for tables of many planes."""
        known = self.surface.memo.get("row")  # cached with the surface, since normal and offset change only with it
        if not isinstance(known, np.ndarray):
            known = np.array([*self.normal.tolist(), self.offset, *self.centroid.tolist()])
            self.surface.memo["row"] = known
        return known

    @property
    def points(self) -> np.ndarray:  # [K, 3] world
        """Return P_i, one measured point per cell of the plane's grid, in metres."""
        return self.surface.points()

    def spread(self, count: int) -> np.ndarray:  # [count, 3] world
        """Return ``count`` of the points at even steps from the first to the last; some repeat if there are fewer."""
        return self.surface.spread(count)

    @property
    def point_count(self) -> int:
        """Return |P_i|, the number of seen cells with at least one measured point."""
        return self.surface.measured_count

    @property
    def rms(self) -> float:
        """Return the root mean square distance in metres of all measured points to the current plane."""
        count = self.moments[0]
        if count < 1:
            return 0.0
        mean = self.moments[1:4] / count
        second = self.moments[_SECOND] / count
        height = self.normal @ self.anchor + self.offset
        square = self.normal @ second @ self.normal + 2.0 * height * (self.normal @ mean) + height**2
        return math.sqrt(max(square, 0.0))

    def fuse(
        self,
        segments: Sequence[PlaneSegment],
        patch: Patch,
        moments: np.ndarray,  # [10] of the segments' points about `anchor`
        keyframe: int,
        rate: float,
    ) -> None:
        """Fuse the segments of one keyframe: moving average of normal and offset, union of the surface.

        ``patch`` is the surface that the keyframe observed. ``rate`` is the weight of a new observation, multiplied by
        the segment's share of the plane's area, so that a view of a corner does not rotate a wall.
        """
        before = (self.centroid, self.area) if self.keyframes else None
        seen = np.array([[*segment.normal.tolist(), segment.offset, segment.area] for segment in segments])
        # The first keyframe defined the plane; its average is this keyframe's.
        rate = rate if self.keyframes else 0.0
        self.normal, self.offset, self.normals[keyframe] = average_plane(
            self.normal, self.offset, self.area, seen, float(np.add.reduce(seen[:, 4] + 1e-12)), rate
        )
        self._forget()
        self.moments += moments
        self.keyframes |= 1 << keyframe
        self.surface.seat(self.normal, self.offset)
        self.surface.add(patch)
        if before is not None:
            self._note_change(*before)

    def absorb(self, other: PlaneNode) -> None:
        """Merge another plane of the same surface into this one; normals and offsets are averaged by area."""
        before = (self.centroid, self.area)
        share = other.area / max(self.area + other.area, 1e-9)
        normal = (1.0 - share) * self.normal + share * other.normal
        size = length(normal)
        self.offset = float(((1.0 - share) * self.offset + share * other.offset) / size)
        self.normal = normal / size
        self.moments += _moved(other.moments, other.anchor - self.anchor)
        self.keyframes |= other.keyframes
        for keyframe, seen in other.normals.items():
            mine = self.normals.get(keyframe)
            seen = seen if mine is None else (1.0 - share) * mine + share * seen
            self.normals[keyframe] = seen / length(seen)
        self.normals = dict(sorted(self.normals.items()))
        self._forget()
        self.surface.seat(self.normal, self.offset)
        self.surface.absorb(other.surface)
        self._note_change(*before)

    def _forget(self) -> None:
        """Remove the observed normals except those of the last ``window`` keyframes."""
        if len(self.normals) > self._window:
            self.normals = dict(sorted(self.normals.items())[-self._window :])

    def _note_change(self, centroid: np.ndarray, area: float) -> None:
        self.shift = distance(self.centroid, centroid)
        self.area_change = abs(self.area - area) / max(area, 1e-9)


def _moved(moments: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Return the moments [10] of a set of points after adding ``by`` [3] to their coordinates."""
    count, first = moments[0], moments[1:4]
    second = moments[_SECOND]
    second = second + np.outer(first, by) + np.outer(by, first) + count * np.outer(by, by)
    return np.concatenate([[count], first + count * by, second[np.triu_indices(3)]])
