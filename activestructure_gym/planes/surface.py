"""Represent the seen part of a plane by a growing grid of square cells in the plane.

Area, centroid, points, coverage, boundary and holes are all computed from this grid. The grid is fixed to the plane and
not to the world's axes, so a rigid motion of scene and cameras changes no cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import cv2
import numpy as np

from activestructure_gym.geometry.frame import Frame
from activestructure_gym.planes import surface_kernels as kernels
from activestructure_gym.planes.detection import PlaneDetection
from activestructure_gym.planes.vectors import cross, length

# Additional cells when a grid grows, so that it is not copied at every keyframe.
_MARGIN = 16
# Disc with a radius of 2 cells, the neighbourhood of a seen cell (10 cm with cells of 5 cm).
_NEAR = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))


@dataclass(frozen=True)
class Patch:
    """Hold the observations of one image in a rectangle of cells of one grid."""

    low: np.ndarray  # [2] int64 row and column of the first cell
    shown: np.ndarray  # [R, C] int32, number of times that the cell's centre was observed as this plane
    denied: np.ndarray  # [R, C] int32, number of times that it was observed as something else
    hits: np.ndarray  # [R, C] int32, number of pixels in the cell
    beside: np.ndarray  # [R, C] uint8: what is in unseen cells, see `surface_kernels.look_up_cells`


class SurfaceGrid:
    """Hold the observed cells of one plane in a grid.

    The frame of the grid is orthonormal: ``axes[0]`` and ``axes[1]`` are in the plane, ``axes[2]`` is its normal, and
    ``origin`` is on the plane. The first cell of the arrays is cell ``low`` of the frame.
    """

    def __init__(self, origin: np.ndarray, axes: np.ndarray, cell: float) -> None:
        self.origin = np.array(origin, dtype=np.float64)  # [3] world
        self.axes = np.array(axes, dtype=np.float64)  # [3, 3] rows
        self.cell = cell  # metres
        self.low = np.zeros(2, np.int64)  # [2] cell of the frame at which the arrays begin
        self.seen = np.zeros((0, 0), np.uint8)  # [R, C] 0 or 1: shown at least once, and at least as often as denied
        self.shown = np.zeros((0, 0), np.int32)  # [R, C] number of times observed as this plane
        self.denied = np.zeros((0, 0), np.int32)  # [R, C] number of times observed as something else
        self.hits = np.zeros((0, 0), np.int32)  # [R, C] number of pixels in the cell
        # [R, C] what images observed in unseen cells: UNKNOWN, OPEN or COVERED.
        self.beside = np.zeros((0, 0), np.uint8)
        self.memo: dict[object, object] = {}  # results computed from this grid; cleared when it changes

    @cached_property
    def frame(self) -> np.ndarray:  # [12] for the kernels
        """Return origin, two axes and normal in one array."""
        return np.concatenate([self.origin, self.axes.ravel()])

    def seat(self, normal: np.ndarray, offset: float) -> None:
        """Move the frame onto the plane ``normal . x + offset = 0`` by the smallest rotation.

        Cells keep their indices.
        """
        old = self.axes[2]
        u = self.axes[0]
        # The smallest rotation from the old to the new normal is applied to a vector in the old plane.
        u = u - (u @ normal) / (1.0 + old @ normal) * (old + normal)
        u = u - (u @ normal) * normal
        u = u / length(u)
        self.axes = np.array([u, cross(normal, u), normal])
        self.origin = self.origin - (normal @ self.origin + offset) * normal
        self._forget()

    def add(self, patch: Patch) -> None:
        """Add the observations of the plane in one image (``patch``)."""
        if not patch.shown.size:
            return
        row, column = self._cover(patch.low, *patch.shown.shape)
        kernels.join(
            self._votes(), kernels.Votes(patch.shown, patch.denied, patch.hits, patch.beside), row, column, self.seen
        )
        if not cv2.countNonZero(self.seen):
            self.seen[:] = self.hits > 0  # a sliver between the centres of cells still gets a cell
        self._forget()

    def absorb(self, other: SurfaceGrid) -> None:
        """Merge another grid of the same plane into this one.

        The other grid is read at the centre of each cell of this grid, so that no gaps arise.
        """
        if not other.seen.size:
            return
        corners = other._to_world(other.low + np.array([[0, 0], [0, 1], [1, 0], [1, 1]]) * other.seen.shape)
        ours = np.floor(self._to_cells(corners)).astype(np.int64)
        low, high = ours.min(axis=0), ours.max(axis=0) + 1
        asked = other._votes()
        answers = kernels.Votes(*(np.zeros(tuple(high - low), array.dtype) for array in asked))
        kernels.ask_cells(self.frame, self.cell, low, other.frame, other.cell, other.low, asked, answers)
        self.add(Patch(low, *answers))

    def _votes(self) -> kernels.Votes:
        return kernels.Votes(self.shown, self.denied, self.hits, self.beside)

    def _cover(self, low: np.ndarray, height: int, width: int) -> tuple[int, int]:
        """Enlarge the arrays to include a rectangle of ``height`` x ``width`` cells that starts at cell ``low``.

        Returns row and column in the arrays at which the rectangle starts.
        """
        row, column = (low - self.low).tolist()
        rows, columns = self.seen.shape
        if rows and row >= 0 and column >= 0 and row + height <= rows and column + width <= columns:
            return row, column
        first, high = low, low + (height, width)
        if self.seen.size:
            low, high = np.minimum(low, self.low), np.maximum(high, self.low + self.seen.shape)
            grown_low = np.where(low < self.low, low - _MARGIN, low)
            grown_high = np.where(high > self.low + self.seen.shape, high + _MARGIN, high)
        else:
            grown_low, grown_high = low, high
        for name in ("seen", "shown", "denied", "hits", "beside"):
            old = getattr(self, name)
            new = np.zeros(tuple(grown_high - grown_low), old.dtype)
            if old.size:
                r, c = self.low - grown_low
                new[r : r + old.shape[0], c : c + old.shape[1]] = old
            setattr(self, name, new)
        self.low = np.array(grown_low, np.int64)
        row, column = (first - self.low).tolist()
        return row, column

    def _forget(self) -> None:
        for name in ("frame", "_cells", "_measured", "_points", "area", "centroid", "near"):
            self.__dict__.pop(name, None)
        self.memo.clear()

    def _to_world(self, cells: np.ndarray) -> np.ndarray:  # [K, 2] -> [K, 3]
        return self.origin + (cells * self.cell) @ self.axes[:2]

    def _to_cells(self, points: np.ndarray) -> np.ndarray:  # [K, 3] -> [K, 2]
        return (points - self.origin) @ self.axes[:2].T / self.cell

    def cell_centres(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:  # [K, 3] world
        """Return the world points of the centres of array cells, on the plane."""
        cells = np.empty((len(rows), 2))
        cells[:, 0], cells[:, 1] = rows, columns
        return self._to_world(cells + self.low + 0.5)

    @cached_property
    def _cells(self) -> tuple[np.ndarray, np.ndarray]:
        return nonzero(self.seen)

    @cached_property
    def _measured(self) -> tuple[np.ndarray, np.ndarray]:
        return nonzero((self.hits > 0).view(np.uint8) & self.seen)

    @cached_property
    def _points(self) -> np.ndarray:  # [K, 3] world
        points = self.cell_centres(*self._shown_cells)
        points.setflags(write=False)  # the array is shared by all callers
        return points

    @property
    def _shown_cells(self) -> tuple[np.ndarray, np.ndarray]:
        return self._measured if self.measured_count else self._cells

    @property
    def measured_count(self) -> int:
        """Return the number of seen cells with at least one measured point."""
        return len(self._measured[0])

    @cached_property
    def area(self) -> float:
        """Return the area of the seen cells in m^2."""
        return (cv2.countNonZero(self.seen) if self.seen.size else 0) * self.cell**2

    @cached_property
    def centroid(self) -> np.ndarray:  # [3] world
        """Return the mean of the centres of the seen cells in metres."""
        sums = cv2.moments(self.seen) if self.seen.size else {"m00": 0.0}  # sums of integers are exact
        if not sums["m00"]:
            return self.origin.copy()
        mean = np.array([sums["m01"] / sums["m00"], sums["m10"] / sums["m00"]])  # row, column
        return self._to_world((mean + self.low + 0.5)[None])[0]

    @cached_property
    def near(self) -> np.ndarray:  # [R, C] uint8
        """Return the mask of the cells that are seen or within two cells of a seen cell."""
        return cv2.dilate(self.seen, _NEAR) if self.seen.size else self.seen

    def points(self, count: int | None = None) -> np.ndarray:  # [K, 3] world
        """Return the centres of the seen cells with a measured point, or an even selection of ``count`` of them.

        If no seen cell has a measured point, all seen cells are used. Without ``count`` the array is read-only.
        """
        points = self._points
        if count is not None and len(points) > count:
            return points[((np.arange(count) + 0.5) * len(points) / count).astype(np.int64)]
        return points

    def spread(self, count: int) -> np.ndarray:  # [count, 3] world
        """Return ``count`` >= 2 of the points at even steps from the first to the last.

        Cached until the grid changes.
        """
        known = self.memo.get(("spread", count))
        if not isinstance(known, np.ndarray):
            rows, columns = self._shown_cells
            at = np.arange(count) * (len(rows) - 1) // (count - 1)
            known = self.memo["spread", count] = self.cell_centres(rows[at], columns[at])
        return known

    def contains(self, points: np.ndarray, *, reach: int = 0) -> np.ndarray:  # [K, 3] world -> [K] bool
        """Return whether the projection of each point onto the plane is within ``reach`` cells of a seen cell."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        return np.asarray(kernels.near_seen(points, self.frame, self.low, self.seen, self.cell, disc(reach)))


class GridStack(NamedTuple):
    """Hold frames, shapes and flat offsets of several grids, for kernels that loop over all cells."""

    frames: np.ndarray  # [N, 12], see `SurfaceGrid.frame`
    lows: np.ndarray  # [N, 2] int64 cell of the frame at which the arrays of each grid begin
    shapes: np.ndarray  # [N, 2] int64 rows and columns
    starts: np.ndarray  # [N + 1] int64 start of each grid in a flat array of all cells


def stack_grids(surfaces: Sequence[SurfaceGrid]) -> GridStack:
    """Return the `GridStack` of one or more grids."""
    shapes = np.array([surface.seen.shape for surface in surfaces], dtype=np.int64)
    return GridStack(
        frames=np.array([surface.frame for surface in surfaces]),
        lows=np.array([surface.low for surface in surfaces]),
        shapes=shapes,
        starts=np.concatenate([[0], np.cumsum(shapes.prod(axis=1))]),
    )


def nonzero(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # [R, C] uint8 -> rows [K], columns [K]
    """Return `numpy.nonzero` of a 2D mask, many times faster for large masks."""
    found = cv2.findNonZero(mask) if mask.size else None
    if found is None:
        return np.zeros(0, np.int32), np.zeros(0, np.int32)
    columns, rows = found.reshape(-1, 2).T
    return rows, columns


@cache
def disc(radius: int) -> np.ndarray:
    """Return a disc with a radius of ``radius`` cells as a structuring element of OpenCV."""
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))


def observe(
    frame: Frame,
    detection: PlaneDetection,
    table: np.ndarray,  # [S] index of the grid of each label, -1 = none
    grids: list[SurfaceGrid],
    anchors: np.ndarray,  # [T, 3] metres, world
    *,
    reach: float,  # metres, see `surface_kernels.look_up_cells`
) -> tuple[list[Patch], np.ndarray]:
    """Return the observations of an image in each of T grids, and the moments [T, 10] of the points in each grid.

    The moments of grid t are about ``anchors[t]``.
    """
    depth = np.ascontiguousarray(frame.depth, dtype=np.float32)
    labels, segments = detection.labels, detection.segments
    camera, pose = frame.camera, np.asarray(frame.world_from_camera, dtype=np.float64)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    rotation, translation = np.ascontiguousarray(pose[:3, :3]), np.ascontiguousarray(pose[:3, 3])
    frames = np.stack([grid.frame for grid in grids])
    cell = grids[0].cell
    table = np.asarray(table, dtype=np.int64)
    image = kernels.LabelledImage(depth, labels, table, lens, rotation, translation)
    extents, moments = kernels.image_sums(image, frames, anchors, cell)
    extents += np.array([-2, -2, 2, 2])  # two cells beyond the edge, to observe what is next to the plane
    shapes = extents[:, 2:] - extents[:, :2] + 1
    starts = np.concatenate([[0], np.cumsum(shapes.prod(axis=1))])
    hits = np.zeros(starts[-1], np.int32)
    seen = np.zeros(starts[-1], np.uint8)
    beside = np.zeros(starts[-1], np.uint8)
    rectangles = kernels.Rectangles(frames, cell, extents, starts)
    kernels.count_hits(image, rectangles, hits)
    planes = np.array([[*segment.normal, segment.offset] for segment in segments])
    centroids = np.array([segment.centroid for segment in segments])
    # Whether each segment is on the side of each grid's plane from which the plane is observed.
    facing = np.einsum("sti,ti->ts", centroids[:, None] - frames[None, :, :3], frames[:, 9:]) > cell
    facing &= table[None] != np.arange(len(grids))[:, None]
    kernels.look_up_cells(image, rectangles, seen, beside, reach, planes, facing)
    patches = []
    for t, shape in enumerate(shapes):
        part = slice(starts[t], starts[t + 1])
        shown, other = seen[part].reshape(shape), beside[part].reshape(shape)
        patches.append(
            Patch(
                low=extents[t, :2],
                shown=shown.astype(np.int32),
                denied=(other != kernels.UNKNOWN).astype(np.int32),
                hits=hits[part].reshape(shape),
                beside=other,
            )
        )
    return patches, moments
