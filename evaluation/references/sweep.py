"""A passive sweep: the way of somebody who carries the camera from room to room and turns round in each place.

For scenes without a recorded sequence, so that systems that do not plan have something to map. It knows the scene's
free space, as who records a sequence does, and nothing of any map.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import label
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from activestructure_gym.ground_truth import FreeSpace
from activestructure_gym.motion import MotionConfig, interpolate
from activestructure_gym.motion.trajectory import poses_at, yaw_pitch

SPACING_M = 2.0  # metres on foot from any free place of the storey to where the camera is turned (own choice)
PITCHES = (0.0, -30.0, 30.0)  # degrees, of one round after the other (own choice)
_SAMPLES = 4  # per voxel along a straight way


def sweep(
    space: FreeSpace,
    start: np.ndarray,  # [4, 4] world_from_camera, level
    frames: int,  # at most, the first one included
    motion: MotionConfig,
) -> np.ndarray:  # [T, 4, 4] world_from_camera
    """A tour at the height of ``start`` through places that lie `SPACING_M` apart, the nearest next, and back.

    In each place the camera turns round once, level on the first tour, down on the second, up on the third; between
    them it looks where it goes. Ends with the frames, or with the third tour.
    """
    layer = Layer(space, start[:3, 3], motion.candidate_clearance)
    tour = layer.tour()
    poses = [start]
    for number, pitch in enumerate(PITCHES):
        for place in tour if number % 2 == 0 else tour[::-1]:
            if len(poses) >= frames:
                return np.stack(poses[:frames])
            poses += _go(poses[-1], layer.way(poses[-1][:3, 3], place), np.radians(pitch), motion)
            poses += _turn_round(poses[-1], motion)
    return np.stack(poses[:frames])


class Layer:
    """The voxels of a free space at one height that are reachable from a place and keep a clearance."""

    def __init__(self, space: FreeSpace, start: np.ndarray, clearance: float) -> None:
        size = space.voxel_size
        place = np.clip(np.floor((start - space.origin) / size).astype(int), 0, np.array(space.clearance.shape) - 1)
        level = space.clearance[:, :, place[2]]
        open_ = level >= clearance
        if not open_.any():  # too narrow a scene: whatever is free
            open_ = level > 0
        open_[tuple(place[:2])] = True
        regions, _ = label(open_)
        self._height = float(start[2])
        self._cells = np.argwhere(regions == regions[tuple(place[:2])])  # [N, 2]
        self._index = np.full(open_.shape, -1)
        self._index[tuple(self._cells.T)] = np.arange(len(self._cells))
        self._origin, self._size = space.origin[:2], size
        self._graph = self._neighbours()
        self._first = int(self._index[tuple(place[:2])])

    def tour(self) -> list[int]:
        """Cells that cover the layer, in the order of a tour: always the nearest of those that are left."""
        nearest = dijkstra(self._graph, indices=self._first)
        places, ways = [self._first], [nearest]
        while nearest.max() > SPACING_M:
            places.append(int(nearest.argmax()))
            ways.append(dijkstra(self._graph, indices=places[-1]))
            nearest = np.minimum(nearest, ways[-1])
        order, left = [0], set(range(1, len(places)))
        while left:
            here = ways[order[-1]]
            order.append(min(left, key=lambda n: (here[places[n]], n)))
            left.remove(order[-1])
        return [places[n] for n in order]

    def way(self, position: np.ndarray, goal: int) -> np.ndarray:  # [P, 3] metres, from ``position``
        """The shortest way to a cell, straight where nothing is in between."""
        cell = self._cell_at(position)
        _, before = dijkstra(self._graph, indices=cell, return_predecessors=True)
        cells = [goal]
        while cells[-1] != cell:
            cells.append(int(before[cells[-1]]))
        corners, here = [position[:2]], len(cells) - 1
        while here > 0:
            # The farthest cell that is seen; the next one always is.
            here = next(n for n in range(here) if n == here - 1 or self._free_between(corners[-1], self._at(cells[n])))
            corners.append(self._at(cells[here]))
        return np.column_stack([corners, np.full(len(corners), self._height)])

    def _at(self, cell: int) -> np.ndarray:  # [2] metres
        return self._origin + (self._cells[cell] + 0.5) * self._size

    def _cell_at(self, position: np.ndarray) -> int:
        """The cell nearest to a position."""
        centres = self._origin + (self._cells + 0.5) * self._size
        return int(np.linalg.norm(centres - position[:2], axis=1).argmin())

    def _free_between(self, one: np.ndarray, other: np.ndarray) -> bool:
        count = max(2, int(np.ceil(np.linalg.norm(other - one) / self._size * _SAMPLES)) + 1)
        points = np.linspace(one, other, count)
        cells = np.floor((points - self._origin) / self._size).astype(int)
        return bool((self._index[tuple(cells.T)] >= 0).all())

    def _neighbours(self) -> csr_array:
        """Metres between cells that share a side, or a corner whose two sides are open too."""
        padded = np.pad(self._index, 1, constant_values=-1)
        x, y = self._cells.T + 1
        rows, columns, metres = [], [], []
        for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1)):
            other = padded[x + dx, y + dy]
            good = (other >= 0) & (padded[x + dx, y] >= 0) & (padded[x, y + dy] >= 0)
            rows += [np.flatnonzero(good), other[good]]
            columns += [other[good], np.flatnonzero(good)]
            metres += [np.full(2 * int(good.sum()), self._size * np.hypot(dx, dy))]
        count = len(self._cells)
        return coo_array(
            (np.concatenate(metres), (np.concatenate(rows), np.concatenate(columns))), (count, count)
        ).tocsr()


def _go(pose: np.ndarray, way: np.ndarray, pitch: float, motion: MotionConfig) -> list[np.ndarray]:
    """The frames along a way, looking where it goes; only the pitch changes where it is none."""
    yaw, now = yaw_pitch(pose)
    step = way[-1] - way[-2] if len(way) > 1 else np.zeros(3)
    if np.hypot(*step[:2]) > 1e-9:
        yaw = np.arctan2(step[1], step[0])
    elif abs(pitch - now) < 1e-9:
        return []
    goal = poses_at(way[-1:], np.array([yaw]), np.array([pitch]))[0]
    return list(interpolate(way if len(way) > 1 else np.vstack([way, way]), pose, goal, motion))


def _turn_round(pose: np.ndarray, motion: MotionConfig) -> list[np.ndarray]:
    """A full turn on the spot, back to where it began."""
    count = int(np.ceil(360.0 / motion.max_turn_deg))
    yaw, pitch = yaw_pitch(pose)
    yaws = yaw + 2.0 * np.pi * np.arange(1, count + 1) / count
    return list(poses_at(np.tile(pose[:3, 3], (count, 1)), yaws, np.full(count, pitch)))
