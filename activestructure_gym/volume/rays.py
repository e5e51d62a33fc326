"""Trace the rays of camera pixels through a voxel grid, and sum values of the voxels that they cross."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.compiling.thread_team import TEAM, default_threads
from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.geometry import PinholeCamera

RAYS_PER_ROW = 40  # approximate number of rays per image row if no stride is given
_LEAST_CHANCE = 1e-3  # a ray ends where the product of ``passing`` falls below this
_SLIVER = 1e-9  # voxels; a ray through an edge touches voxels in such a length by rounding only
_NO_MARKS = np.zeros((0, 0, 0), np.bool_)


def rays_of_pixels(
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [K, 4, 4] or [4, 4]
    stride: int | None = None,  # pixels from one ray to the next; None: about 40 rays per image row
) -> tuple[np.ndarray, np.ndarray]:  # [K, 4, 4], [h, w, 3]
    """Return the camera poses, and the rays of every ``stride``-th pixel in the camera frame with depth 1.

    Both are float64, as kernels need them.
    """
    poses = np.ascontiguousarray(world_from_camera, dtype=np.float64).reshape(-1, 4, 4)
    step = max(1, round(camera.width / RAYS_PER_ROW)) if stride is None else stride
    return poses, camera.rays()[::step, ::step].astype(np.float64)


@dataclass(frozen=True)
class PixelRays:
    """Hold the h x w rays of each of K views through the volume; made by `VoxelVolume.rays`.

    A ray starts at the camera. It ends at the border of the volume or after ``reach`` metres.
    """

    origin: np.ndarray  # [3] metres, world: lower corner of voxel (0, 0, 0)
    voxel_size: float  # metres
    occupied: np.ndarray  # [X, Y, Z] bool
    world_from_camera: np.ndarray  # [K, 4, 4] float64
    directions: np.ndarray  # [h, w, 3] float64 unit vectors, camera frame
    reach: float  # metres along a ray

    def sums(
        self, values: np.ndarray, passing: np.ndarray | None = None, *, per_metre: bool = False
    ) -> np.ndarray:  # [K, h, w] float64
        """Sum values of the voxels that each ray crosses, weighted by the probability that the ray reaches the voxel.

        The sum over the voxels v_1, v_2, ... on a ray is sum_n values(v_n) prod_(m < n) passing(v_m).

        Parameters
        ----------
        values : ndarray
            [X, Y, Z] value of each voxel: numbers, or a mask.
        passing : ndarray, optional
            [X, Y, Z] probability in 0..1 that a ray passes the voxel, such as ``1 - occupancy``. By default a ray ends
            in the first occupied voxel. It always ends where the product falls below 0.001.
        per_metre : bool
            Multiply each value by the length in metres of the ray in the voxel.

        Returns
        -------
        ndarray
            [K, h, w] sum of each ray.

        Raises
        ------
        InputError
            An array does not have the shape of the volume, or ``passing`` is not in 0..1.
        """
        through = ~self.occupied if passing is None else passing
        given = self._of_voxels("values", values), self._of_voxels("passing", through)
        if passing is not None and not (given[1].min() >= 0.0 and given[1].max() <= 1.0):
            raise InputError(f"passing must be in 0..1, got values from {given[1].min()} to {given[1].max()}")
        return self._traced(*given, _NO_MARKS, per_metre)

    def seen(self) -> np.ndarray:  # [X, Y, Z] bool
        """Return which voxels the rays of all K views cross, up to and including the first occupied voxel of each."""
        marks = np.zeros(self.occupied.shape, np.bool_)
        passing = (~self.occupied).astype(np.float32)
        self._traced(passing, passing, marks, False)
        return marks

    def _of_voxels(self, name: str, given: Any) -> np.ndarray:  # [X, Y, Z] float32
        array = np.array(given, dtype=np.float32, order="C")  # a copy: a read-only array would need another kernel
        if array.shape != self.occupied.shape:
            raise InputError(
                f"{name} must have one number per voxel, {self.occupied.shape}, got {short_repr(array.shape)}"
            )
        return array

    def _traced(self, values: np.ndarray, passing: np.ndarray, marks: np.ndarray, per_metre: bool) -> np.ndarray:
        poses, end = self.world_from_camera, self.reach / self.voxel_size
        scale = self.voxel_size if per_metre else 0.0
        starts = (poses[:, :3, 3] - self.origin) / self.voxel_size
        result = np.zeros((len(poses), *self.directions.shape[:2]))
        views = count()

        def work() -> None:
            while (k := next(views)) < len(poses):
                along = self.directions @ poses[k, :3, :3].T
                _trace(values, passing, marks, starts[k], along, end, scale, result[k])

        TEAM.run(work, (), max(1, min(default_threads(), len(poses))))
        return result


@kernel
def _trace(
    values: np.ndarray,  # [X, Y, Z] float32
    passing: np.ndarray,  # [X, Y, Z] float32 in 0..1
    marks: np.ndarray,  # [X, Y, Z] bool, set where a ray crosses a voxel; empty: nothing is marked
    start: np.ndarray,  # [3] camera position in voxels; the lower corner of voxel (0, 0, 0) is at (0, 0, 0)
    directions: np.ndarray,  # [h, w, 3] unit vectors along the axes of the grid
    end: float,  # length of a ray in voxels
    scale: float,  # metres per voxel, to weight values by length; 0: each voxel counts once
    sums: np.ndarray,  # [h, w] output
) -> None:
    """Write the sum of `PixelRays.sums` for every ray of a view; every voxel on a ray is visited ([amanatides1987])."""
    size_x, size_y, size_z = values.shape
    marking = marks.size > 0
    for row in range(directions.shape[0]):
        for column in range(directions.shape[1]):
            dx, dy, dz = directions[row, column, 0], directions[row, column, 1], directions[row, column, 2]
            x, y, z = start[0], start[1], start[2]
            i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
            # Lengths along the ray: between two voxel boundaries of each axis, and to the first boundary.
            step_x, step_y, step_z = 1.0 / abs(dx), 1.0 / abs(dy), 1.0 / abs(dz)
            next_x = ((i + 1 if dx > 0 else i) - x) / dx if dx != 0.0 else np.inf
            next_y = ((j + 1 if dy > 0 else j) - y) / dy if dy != 0.0 else np.inf
            next_z = ((k + 1 if dz > 0 else k) - z) / dz if dz != 0.0 else np.inf
            total, chance, at, entered = 0.0, 1.0, 0.0, False
            while at < end:
                leave = min(next_x, next_y, next_z)
                if 0 <= i < size_x and 0 <= j < size_y and 0 <= k < size_z:
                    entered = True
                    length = min(leave, end) - at
                    if length > _SLIVER:
                        total += chance * values[i, j, k] * (scale * length if scale > 0.0 else 1.0)
                        if marking:
                            marks[i, j, k] = True
                        chance *= passing[i, j, k]
                        if chance < _LEAST_CHANCE:
                            break
                elif entered:
                    break
                at = leave
                if next_z < min(next_x, next_y):
                    next_z += step_z
                    k += 1 if dz > 0 else -1
                elif next_y < next_x:
                    next_y += step_y
                    j += 1 if dy > 0 else -1
                else:
                    next_x += step_x
                    i += 1 if dx > 0 else -1
            sums[row, column] = total
