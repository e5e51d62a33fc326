"""Represent the seen part of a plane by a growing grid of square cells in the plane.

Area, centroid, points, coverage, boundary and holes are all computed from this grid. The grid is fixed to the plane and
not to the world's axes, so a rigid motion of scene and cameras changes no cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, cached_property
from typing import NamedTuple

import cv2
import numpy as np

from activestructure_gym.geometry.frame import Frame
from activestructure_gym.planes import surface_kernels as kernels
from activestructure_gym.planes.detection import PlaneDetection, PlaneDetectionConfig

# Additional cells when a grid grows, so that it is not copied at every keyframe.
_MARGIN = 16
# Disc with a radius of 2 cells, the neighbourhood of a seen cell (10 cm with cells of 5 cm).
_NEAR = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))


class Patch(NamedTuple):
    """Hold the observations of one image in a rectangle of cells of one grid."""

    low: np.ndarray  # [2] int64 row and column of the first cell
    shown: np.ndarray  # [R, C] number of times that the cell's centre was observed as this plane
    denied: np.ndarray  # [R, C] number of times that it was observed as something else
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
        self.axes, self.origin = kernels.seat(self.axes, self.origin, normal, offset)
        self._forget()

    def add(self, patch: Patch) -> None:
        """Add the observations of the plane in one image (``patch``)."""
        if not patch.shown.size:
            return
        row, column = self._cover(patch.low, *patch.shown.shape)
        kernels.join(self._votes(), kernels.Votes(*patch[1:]), row, column, self.seen)
        self._forget()
        if not self._measures[0]:
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
        if not rows:
            self._grow(low, 0, 0, height, width)
            return 0, 0
        above, left = (_MARGIN - row if row < 0 else 0), (_MARGIN - column if column < 0 else 0)
        below, right = row + height - rows, column + width - columns
        self._grow(
            self.low - (above, left),
            above,
            left,
            above + rows + (below + _MARGIN if below > 0 else 0),
            left + columns + (right + _MARGIN if right > 0 else 0),
        )
        return row + above, column + left

    def _grow(self, low: np.ndarray, row: int, column: int, rows: int, columns: int) -> None:
        """Enlarge the arrays to ``rows`` x ``columns`` cells from cell ``low``; the old cells move to (row, column)."""
        old = self.seen, self.beside, self.shown, self.denied, self.hits
        masks, counts = np.zeros((2, rows, columns), np.uint8), np.zeros((3, rows, columns), np.int32)
        self.seen, self.beside, self.shown, self.denied, self.hits = new = *masks, *counts
        height, width = old[0].shape
        for before, after in zip(old, new):
            after[row : row + height, column : column + width] = before
        self.low = np.array(low, np.int64)

    def _forget(self) -> None:
        for name in ("frame", "_cells", "_measured", "_points", "_measures", "near"):
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
    def _measures(self) -> tuple[int, int, np.ndarray]:
        """Return the number of seen cells, the number of these with a measured point, and the centroid [3]."""
        found: tuple[int, int, np.ndarray] = kernels.measure(
            self.seen, self.hits, self.low, self.cell, self.axes, self.origin
        )
        return found

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
        return self._measures[1]

    @property
    def area(self) -> float:
        """Return the area of the seen cells in m^2."""
        return self._measures[0] * self.cell**2

    @property
    def centroid(self) -> np.ndarray:  # [3] world
        """Return the mean of the centres of the seen cells in metres."""
        return self._measures[2]

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
            cells = kernels.even_cells(self.seen, self.hits, self._measures[1], self._measures[0], count)
            known = self.memo["spread", count] = self._to_world(cells + self.low + 0.5)
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
    config: PlaneDetectionConfig,  # with which the planes were detected
) -> tuple[list[Patch], np.ndarray]:
    """Return the observations of an image in each of T grids, and the moments [T, 10] of the points in each grid.

    The moments of grid t are about ``anchors[t]``.
    """
    depth = np.ascontiguousarray(frame.depth, dtype=np.float32)
    labels, segments = detection.labels, detection.segments
    camera, pose = frame.camera, np.asarray(frame.world_from_camera, dtype=np.float64)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    rotation, translation = np.ascontiguousarray(pose[:3, :3]), np.ascontiguousarray(pose[:3, 3])
    frames = np.array([grid.frame for grid in grids])
    cell = grids[0].cell
    table = np.asarray(table, dtype=np.int64)
    image = kernels.LabelledImage(depth, labels, table, lens, rotation, translation)
    extents, moments, cells = kernels.image_sums(image, frames, anchors, cell)
    extents += np.array([-2, -2, 2, 2])  # two cells beyond the edge, to observe what is next to the plane
    shapes = extents[:, 2:] - extents[:, :2] + 1
    starts = np.concatenate([[0], np.cumsum(shapes.prod(axis=1))])
    hits = np.zeros(starts[-1], np.int32)
    shown, denied, beside = np.zeros((3, starts[-1]), np.uint8)
    rectangles = kernels.Rectangles(frames, cell, extents, starts)
    kernels.count_hits(labels, table, cells, extents, starts, hits)
    planes = np.array([[*segment.normal.tolist(), segment.offset] for segment in segments])
    centroids = np.array([segment.centroid for segment in segments])
    # Whether each segment is on the side of each grid's plane from which the plane is observed.
    facing = np.einsum("sti,ti->ts", centroids[:, None] - frames[None, :, :3], frames[:, 9:]) > cell
    facing &= table[None] != np.arange(len(grids))[:, None]
    tolerance = np.array([config.depth_noise_scale, config.pixel_sigma, config.pixel_tolerance])
    kernels.look_up_cells(image, rectangles, shown, beside, reach, tolerance, planes, facing)
    np.not_equal(beside, kernels.UNKNOWN, out=denied.view(bool))
    patches = []
    for t, shape in enumerate(shapes.tolist()):
        part = slice(starts[t], starts[t + 1])
        patches.append(Patch(extents[t, :2], *(array[part].reshape(shape) for array in (shown, denied, hits, beside))))
    return patches, moments
