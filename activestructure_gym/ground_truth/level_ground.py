"""Find the surfaces below and above a free region: level ground over which a camera can be carried."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from activestructure_gym.geometry import fibonacci_directions
from activestructure_gym.ground_truth.voxelized import VoxelizedScene

CAMERA_HEIGHTS = (1.2, 1.5)  # metres above the floor: a camera carried by hand or on a mast
_LEVEL = 0.8  # minimum |z| of a level surface's normal: slopes up to 37 degrees
_EYES = 200  # maximum number of voxels from which `front_share` casts rays
_DIRECTIONS = 64  # number of rays per voxel


@dataclass(frozen=True, eq=False)
class Ground:
    """Hold the surfaces below and above a region, one row for each of R vertical runs of consecutive voxels."""

    columns: np.ndarray  # [R, 2] int64, x and y index of the run
    below: np.ndarray  # [R] float64 metres: z of the surface below the run, -inf = none
    above: np.ndarray  # [R] float64 metres: z of the surface above the run, inf = none
    # [R] float64 m^2: area of level ground below the run, times the share of the camera heights that are in the run
    area: np.ndarray
    floor_behind: np.ndarray  # [R] bool: the surface below is level, and its normal points down, away from the run
    ceiling_behind: np.ndarray  # [R] bool: the surface above is level, and its normal points up, away from the run

    @cached_property
    def level_area(self) -> float:
        """Return the area in m^2 of level ground over which a camera can be carried."""
        return float(self.area.sum())

    @cached_property
    def floor(self) -> float | None:
        """Return the median z of the level ground in metres; None if there is none."""
        return _median(self.below, self.area)

    def standing(self, grid: VoxelizedScene) -> np.ndarray:  # [S, 3] int64
        """Return the indices of the voxels at camera height (1.35 m) above the level ground, one per run."""
        rows = np.flatnonzero(self.area > 0)
        height = self.below[rows] + 0.5 * sum(CAMERA_HEIGHTS)
        k = np.floor((height - grid.origin[2]) / grid.voxel_size).astype(np.int64)
        return np.column_stack([self.columns[rows], np.clip(k, 0, grid.occupied.shape[2] - 1)])

    @property
    def covered_share(self) -> float:
        """Return the fraction of level ground that has a surface above it, 0..1."""
        return float(self.area[np.isfinite(self.above)].sum() / max(self.level_area, 1e-9))

    @property
    def ceiling_height(self) -> float | None:
        """Return the median height in metres from ground to ceiling; None if most of the ground has no ceiling."""
        if self.covered_share < 0.5:
            return None
        covered = np.isfinite(self.above)
        return _median((self.above - self.below)[covered], self.area[covered])

    @cached_property
    def is_bare(self) -> bool:
        """Return whether the floor is empty: it is the surface below (within 0.15 m) for more than 97 % of the runs."""
        return self.floor is not None and float((np.abs(self.below - self.floor) < 0.15).mean()) > 0.97

    @property
    def floor_behind_share(self) -> float:
        """Return the fraction of level ground with its back side towards the region, 0..1."""
        return float(self.area[self.floor_behind].sum() / max(self.level_area, 1e-9))

    @property
    def ceiling_behind_share(self) -> float:
        """Return the fraction of level ground whose ceiling has its back side towards the region, 0..1."""
        return float(self.area[self.ceiling_behind].sum() / max(self.level_area, 1e-9))


def ground_of(
    grid: VoxelizedScene,
    voxels: np.ndarray,  # [X, Y, Z] bool, a part of the grid
    corner: Sequence[int] = (0, 0, 0),  # first index of the part
) -> Ground:
    """Find the surfaces below and above the vertical runs of ``voxels``, by one ray down and one ray up per run."""
    steps = np.diff(np.pad(voxels, ((0, 0), (0, 0), (1, 1))).astype(np.int8), axis=2)
    # Entry k of both arrays belongs to the same run, since runs do not overlap.
    first, last = np.argwhere(steps == 1) + corner, np.argwhere(steps == -1) + corner - [0, 0, 1]
    lowest, highest = grid.centers(first), grid.centers(last)
    down, down_z = _cast(grid, lowest, -1.0)
    up, up_z = _cast(grid, highest, 1.0)
    below, above = lowest[:, 2] - down, highest[:, 2] + up
    half = 0.5 * grid.voxel_size
    # The part of the camera's height range inside the run.
    reached = np.minimum(below + CAMERA_HEIGHTS[1], highest[:, 2] + half) - np.maximum(
        below + CAMERA_HEIGHTS[0], lowest[:, 2] - half
    )
    share = np.clip(np.where(np.isfinite(below), reached, 0.0) / (CAMERA_HEIGHTS[1] - CAMERA_HEIGHTS[0]), 0.0, 1.0)
    return Ground(
        columns=first[:, :2],
        below=below,
        above=above,
        area=share * (np.abs(down_z) >= _LEVEL) * grid.voxel_size**2,
        floor_behind=down_z <= -_LEVEL,  # the normal points down, away from the region
        ceiling_behind=up_z >= _LEVEL,
    )


def front_share(grid: VoxelizedScene, places: np.ndarray) -> float:  # [N, 3] voxels -> 0..1
    """Return the fraction of rays from the voxels ``places`` that hit a surface from its front, among rays with a hit.

    Inside a solid body all surfaces are seen from the back; a mesh without consistent winding has about 0.5.
    """
    places = places[np.unique(np.linspace(0, len(places) - 1, _EYES).astype(np.int64))]
    directions = fibonacci_directions(_DIRECTIONS)
    eyes = np.repeat(grid.centers(places), len(directions), axis=0)
    rays = np.tile(directions, (len(places), 1))
    hits = grid.scene.raycaster.cast(eyes, rays)
    met = hits.face >= 0
    facing = np.einsum("ij,ij->i", _normals(grid, hits.face[met]), rays[met])
    return float((facing < 0).mean()) if met.any() else 0.5


def _cast(grid: VoxelizedScene, points: np.ndarray, way: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance [N] from each point to the surface below (``way`` -1) or above (1), and the z of its normal.

    A miss has an infinite distance and z = 0.
    """
    hits = grid.scene.raycaster.cast(points, np.broadcast_to([0.0, 0.0, way], points.shape))
    met = hits.face >= 0
    normal_z = np.zeros(len(points))
    normal_z[met] = _normals(grid, hits.face[met])[:, 2]
    return hits.distance.astype(np.float64), normal_z


def _normals(grid: VoxelizedScene, faces: np.ndarray) -> np.ndarray:  # [N] -> [N, 3] unit, by the winding
    mesh = grid.scene.mesh
    corners = mesh.vertices[mesh.faces[faces]].astype(np.float64)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return normal / np.maximum(np.linalg.norm(normal, axis=1), 1e-30)[:, None]


def _median(values: np.ndarray, weights: np.ndarray) -> float | None:
    """Return the weighted median of ``values``; None if no weight is positive."""
    values, weights = values[weights > 0], weights[weights > 0]
    if not len(values):
        return None
    order = np.argsort(values, kind="stable")
    cumulated = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(cumulated, 0.5 * cumulated[-1])])
