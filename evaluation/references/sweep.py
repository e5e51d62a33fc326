"""Generate a passive sweep: a camera path from room to room with a full turn at each stop.

A sweep replaces a recorded sequence for systems that do not plan. It uses the scene's true free space, not the map.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import label
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from activestructure_gym.ground_truth import FreeSpace
from activestructure_gym.motion import MotionConfig, interpolate
from activestructure_gym.motion.trajectory import poses_at, yaw_pitch

SPACING_M = 2.0  # maximum path length in metres from any reachable cell to the nearest stop (own choice)
PITCHES = (0.0, -30.0, 30.0)  # pitch of the camera in degrees, one per tour; positive is up (own choice)
_SAMPLES = 4  # tested points per voxel on a straight line


def sweep(
    space: FreeSpace,
    start: np.ndarray,  # [4, 4] world_from_camera, level
    frames: int,  # maximum, including the first one
    motion: MotionConfig,
) -> np.ndarray:  # [T, 4, 4] world_from_camera
    """Return the poses of three tours at the height of ``start`` through all stops.

    Every reachable cell has a stop within 2 m of path (`SPACING_M`). The first and the third tour always go to the
    nearest remaining stop; the second tour goes back. The camera makes a full turn at each stop, with one pitch per
    tour (`PITCHES`), and between the stops it looks in the direction of motion. The sweep ends after ``frames``
    poses or after the third tour.
    """
    layer = Layer(space, start[:3, 3], motion.candidate_clearance)
    tour = layer.tour()
    poses = [start]
    for number, pitch in enumerate(PITCHES):
        for place in tour if number % 2 == 0 else tour[::-1]:
            if len(poses) >= frames:
                return np.stack(poses[:frames])
            poses += _go(poses[-1], layer.path(poses[-1][:3, 3], place), np.radians(pitch), motion)
            poses += _turn_round(poses[-1], motion)
    return np.stack(poses[:frames])


class Layer:
    """Represent the cells (voxels at one height) that are reachable from ``start`` with a clearance.

    ``start`` [3] is a position and ``clearance`` a distance, both in metres.
    """

    def __init__(self, space: FreeSpace, start: np.ndarray, clearance: float) -> None:
        size = space.voxel_size
        place = np.clip(np.floor((start - space.origin) / size).astype(int), 0, np.array(space.clearance.shape) - 1)
        level = space.clearance[:, :, place[2]]
        open_ = level >= clearance
        if not open_.any():  # no voxel has this clearance: use all free voxels
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
        """Return the indices of the cells with stops, in the order of the tour.

        The farthest cell becomes the next stop until every cell has a stop within 2 m of path (`SPACING_M`). The tour
        begins at the start and always goes to the nearest remaining stop.
        """
        nearest = dijkstra(self._graph, indices=self._first)
        places, metres = [self._first], [nearest]
        while nearest.max() > SPACING_M:
            places.append(int(nearest.argmax()))
            metres.append(dijkstra(self._graph, indices=places[-1]))
            nearest = np.minimum(nearest, metres[-1])
        order, left = [0], set(range(1, len(places)))
        while left:
            here = metres[order[-1]]
            order.append(min(left, key=lambda n: (here[places[n]], n)))
            left.remove(order[-1])
        return [places[n] for n in order]

    def path(self, position: np.ndarray, goal: int) -> np.ndarray:  # [P, 3] metres, from ``position``
        """Return the corners of the shortest path from ``position`` to the cell ``goal``.

        Detours over the centres of cells are replaced by straight lines where the line is free.
        """
        cell = self._cell_at(position)
        _, before = dijkstra(self._graph, indices=cell, return_predecessors=True)
        cells = [goal]
        while cells[-1] != cell:
            cells.append(int(before[cells[-1]]))
        corners, here = [position[:2]], len(cells) - 1
        while here > 0:
            # Go straight to the farthest cell with a free line; the line to the next cell is always free.
            here = next(n for n in range(here) if n == here - 1 or self._free_between(corners[-1], self._at(cells[n])))
            corners.append(self._at(cells[here]))
        return np.column_stack([corners, np.full(len(corners), self._height)])

    def _at(self, cell: int) -> np.ndarray:  # [2] metres, centre of the cell
        return self._origin + (self._cells[cell] + 0.5) * self._size

    def _cell_at(self, position: np.ndarray) -> int:
        """Return the index of the cell nearest to a position [3]."""
        centres = self._origin + (self._cells + 0.5) * self._size
        return int(np.linalg.norm(centres - position[:2], axis=1).argmin())

    def _free_between(self, one: np.ndarray, other: np.ndarray) -> bool:
        count = max(2, int(np.ceil(np.linalg.norm(other - one) / self._size * _SAMPLES)) + 1)
        points = np.linspace(one, other, count)
        cells = np.floor((points - self._origin) / self._size).astype(int)
        return bool((self._index[tuple(cells.T)] >= 0).all())

    def _neighbours(self) -> csr_array:
        """Return the graph of adjacent cells [N, N] with distances in metres; a diagonal needs both side cells."""
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


def _go(pose: np.ndarray, path: np.ndarray, pitch: float, motion: MotionConfig) -> list[np.ndarray]:
    """Return the poses [4, 4] from ``pose`` along a path [P, 3], looking in the direction of motion.

    ``pitch`` in radians is reached at the end. A path of one point changes only the pitch.
    """
    yaw, now = yaw_pitch(pose)
    step = path[-1] - path[-2] if len(path) > 1 else np.zeros(3)
    if np.hypot(*step[:2]) > 1e-9:
        yaw = np.arctan2(step[1], step[0])
    elif abs(pitch - now) < 1e-9:
        return []
    goal = poses_at(path[-1:], np.array([yaw]), np.array([pitch]))[0]
    return list(interpolate(path if len(path) > 1 else np.vstack([path, path]), pose, goal, motion))


def _turn_round(pose: np.ndarray, motion: MotionConfig) -> list[np.ndarray]:
    """Return the poses [4, 4] of a full turn in place, which ends at the initial ``pose``."""
    count = int(np.ceil(360.0 / motion.max_turn_deg))
    yaw, pitch = yaw_pitch(pose)
    yaws = yaw + 2.0 * np.pi * np.arange(1, count + 1) / count
    return list(poses_at(np.tile(pose[:3, 3], (count, 1)), yaws, np.full(count, pitch)))
