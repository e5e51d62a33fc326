"""Project the observed surface of planes by a parallel projection: covered pixels, and their nearness to the viewer.

The observed surface of a plane is a set of square cells of a grid on the plane.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from activestructure_gym.planes.record import GraphArrays, seen_cells

_PAD = 2  # number of empty cells added at each side of a grid, so its outline is closed
_EDGE_ON = 1e-3  # a plane is not drawn if its projected area is less than this share of its area: it is seen edge-on
NO_PLANE = -1  # plane index of pixels without a plane


@dataclass(frozen=True)
class Projection:
    """Hold a parallel projection of world points onto an image with x right and y down."""

    rows: np.ndarray  # [2, 3] pixels per metre; a point p is at the pixel position rows @ p + shift
    shift: np.ndarray  # [2] pixels
    towards: np.ndarray  # [3] unit vector from the scene to the viewer
    size: tuple[int, int]  # width, height in pixels

    def pixels(self, points: np.ndarray) -> np.ndarray:  # [..., 3] metres -> [..., 2]
        """Return the pixel positions (x, y) of world points."""
        return points @ self.rows.T + self.shift

    def nearness(self, points: np.ndarray) -> np.ndarray:  # [..., 3] -> [...] metres, larger = nearer to the viewer
        """Return the coordinates of world points along the direction to the viewer."""
        return points @ self.towards


def fit_projection(points: np.ndarray, right: np.ndarray, towards: np.ndarray, scale: float, margin: int) -> Projection:
    """Return the projection that shows all ``points`` [K, 3] (metres) at ``scale`` pixels per metre.

    ``right`` and ``towards`` are unit vectors [3]: the image's x direction, and the direction to the viewer. ``margin``
    is the number of pixels around the points.
    """
    down = np.cross(right, towards)
    rows = scale * np.stack([right, down])
    flat = points @ rows.T
    low, high = flat.min(axis=0), flat.max(axis=0)
    width, height = (max(1, int(np.ceil(side)) + 2 * margin) for side in high - low)
    return Projection(rows, margin - low, towards, (width, height))


def outer_cells(arrays: GraphArrays) -> np.ndarray:  # [K, 3] metres
    """Return the centres of the first and the last observed cell in each grid row of each plane.

    Their bounds are those of all observed cells.
    """
    cell, points = float(arrays["cell"]), [np.zeros((0, 3))]
    for plane in range(len(arrays["ids"])):
        seen = seen_cells(arrays, plane) > 0
        rows = np.flatnonzero(seen.any(axis=1))
        first, last = seen[rows].argmax(axis=1), seen.shape[1] - 1 - seen[rows, ::-1].argmax(axis=1)
        cells = np.concatenate([np.stack([rows, ends], axis=1) for ends in (first, last)]) + 0.5
        points.append(arrays["patch_corners"][plane] + cell * cells @ arrays["patch_axes"][plane])
    return np.concatenate(points)


Window = tuple[slice, slice]  # rows and columns of an image


def covered_pixels(
    arrays: GraphArrays, plane: int, view: Projection
) -> tuple[Window, np.ndarray, np.ndarray] | None:  # window, [h, w] bool, [h, w] metres
    """Return the pixels that a plane's observed cells cover, with smoothed outlines.

    The result is a window of the image, whether each pixel of the window is covered, and the nearness of each pixel.
    It is None if the plane is seen edge-on or outside the image.
    """
    found = _covered(arrays, plane, view)
    if found is None:
        return None
    window, shown, first, start, steps = found
    along = np.linalg.inv(steps).T @ (float(arrays["cell"]) * arrays["patch_axes"][plane] @ view.towards)  # per pixel
    x = np.arange(window[1].start, window[1].stop) - start[0]
    y = np.arange(window[0].start, window[0].stop) - start[1]
    return window, shown, view.nearness(first) + along[0] * x + (along[1] * y)[:, None]


def _covered(
    arrays: GraphArrays, plane: int, view: Projection
) -> tuple[Window, np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """Return the window and the covered pixels as in `covered_pixels`, and how the plane's grid is placed in the image.

    The latter is the centre of the first cell [3] in metres, its pixel position [2], and the steps in pixels from a
    cell to the next row and the next column [2, 2].
    """
    cell, axes = float(arrays["cell"]), arrays["patch_axes"][plane]
    grid = np.pad(seen_cells(arrays, plane), _PAD).astype(np.float32)
    steps = view.rows @ axes.T * cell  # [2, 2] pixels per row, per column
    if abs(np.linalg.det(steps)) < _EDGE_ON * cell**2 * np.linalg.norm(view.rows[0]) ** 2:
        return None
    first = arrays["patch_corners"][plane] + (0.5 - _PAD) * cell * axes.sum(axis=0)  # centre of the first cell
    start = view.pixels(first) - 0.5
    ends = start + np.array([[0, 0], [0, 1], [1, 0], [1, 1]]) * grid.shape @ steps.T
    low = np.maximum(np.floor(ends.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(ends.max(axis=0)).astype(int) + 1, view.size)
    if (low >= high).any():
        return None
    matrix = np.column_stack([steps[:, 1], steps[:, 0], start - low])
    size = tuple(int(side) for side in high - low)
    shown = cv2.warpAffine(cv2.GaussianBlur(grid, (3, 3), 0.7), matrix, size, flags=cv2.INTER_LINEAR) > 0.5
    if not shown.any():
        shown = cv2.warpAffine(grid, matrix, size, flags=cv2.INTER_NEAREST) > 0.5
    window = slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))
    return window, shown, first, start, steps


def nearest_planes(
    arrays: GraphArrays, view: Projection
) -> tuple[np.ndarray, np.ndarray]:  # [H, W] int32 row of the plane or -1, [H, W] metres
    """Return the index of the nearest plane at each pixel, and its nearness.

    Planes that face away from the viewer are not drawn. A pixel without a plane has the index `NO_PLANE`.
    """
    width, height = view.size
    owner = np.full((height, width), NO_PLANE, np.int32)
    nearness = np.full((height, width), -np.inf)
    for plane in range(len(arrays["ids"])):
        if arrays["normals"][plane] @ view.towards <= 0:
            continue
        found = covered_pixels(arrays, plane, view)
        if found is None:
            continue
        window, shown, near = found
        wins = shown & (near > nearness[window])
        owner[window][wins] = plane
        nearness[window][wins] = near[wins]
    return owner, nearness


def silhouette(arrays: GraphArrays, plane: int, view: Projection) -> tuple[Window, np.ndarray] | None:
    """Return the window and the covered pixels of a plane: the first two results of `covered_pixels`, or None."""
    found = _covered(arrays, plane, view)
    return None if found is None else found[:2]


def outlines(arrays: GraphArrays, plane: int, view: Projection) -> Iterator[np.ndarray]:  # [K, 2] pixels each
    """Yield the borders of a plane's observed surface, including the borders of holes, as closed lines of pixels."""
    found = silhouette(arrays, plane, view)
    if found is not None:
        yield from borders(*found)


def borders(window: Window, shown: np.ndarray) -> Iterator[np.ndarray]:  # [K, 2] pixels each
    """Yield the borders of the covered pixels ``shown`` of a window, including the borders of holes."""
    rows, columns = window
    lines, _ = cv2.findContours(shown.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    for line in lines:
        if len(line) > 2:
            yield line[:, 0].astype(np.float64) + [columns.start, rows.start]
