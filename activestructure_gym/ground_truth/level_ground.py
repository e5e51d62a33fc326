"""The surfaces below and above a region of free space: where a camera can be carried over level ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from activestructure_gym.geometry import fibonacci_directions
from activestructure_gym.ground_truth.voxelized import VoxelizedScene

CAMERA_HEIGHTS = (1.2, 1.5)  # metres above the floor: a camera carried or on a mast
_LEVEL = 0.8  # a level surface's normal has at least this |z|: slopes up to 37 degrees
_EYES = 200  # voxels of a region from which its surfaces are looked at
_DIRECTIONS = 64


@dataclass(frozen=True, eq=False)
class Ground:
    """The surfaces below and above a region, one row for each vertical run of its voxels."""

    columns: np.ndarray  # [R, 2] int64, x and y index of the run
    below: np.ndarray  # [R] float64 metres: z of the surface below the run, -inf = none
    above: np.ndarray  # [R] float64 metres: z of the surface above the run, inf = none
    area: np.ndarray  # [R] float64 m2 of level ground below the run that a camera is carried over
    floor_behind: np.ndarray  # [R] bool: the surface below is level and is seen from behind
    ceiling_behind: np.ndarray  # [R] bool: likewise the surface above

    @cached_property
    def level_area(self) -> float:
        """Square metres of level ground within a camera's reach."""
        return float(self.area.sum())

    @cached_property
    def floor(self) -> float | None:
        """Median z of the level ground, metres; None where there is none."""
        return _median(self.below, self.area)

    def standing(self, grid: VoxelizedScene) -> np.ndarray:  # [S, 3] int64
        """Return the voxels at the camera's height above the level ground."""
        rows = np.flatnonzero(self.area > 0)
        height = self.below[rows] + 0.5 * sum(CAMERA_HEIGHTS)
        k = np.floor((height - grid.origin[2]) / grid.voxel_size).astype(np.int64)
        return np.column_stack([self.columns[rows], np.clip(k, 0, grid.occupied.shape[2] - 1)])

    @property
    def covered_share(self) -> float:
        """Share of the level ground that has a surface above it, 0..1."""
        return float(self.area[np.isfinite(self.above)].sum() / max(self.level_area, 1e-9))

    @property
    def ceiling_height(self) -> float | None:
        """Median metres from level ground to the surface above; None where most of the ground has none."""
        if self.covered_share < 0.5:
            return None
        covered = np.isfinite(self.above)
        return _median((self.above - self.below)[covered], self.area[covered])

    @cached_property
    def is_bare(self) -> bool:
        """Whether nothing stands on the floor: all but 3 % of the runs end on it."""
        return self.floor is not None and float((np.abs(self.below - self.floor) < 0.15).mean()) > 0.97

    @property
    def floor_behind_share(self) -> float:
        """Share of the level ground that is seen from behind, 0..1."""
        return float(self.area[self.floor_behind].sum() / max(self.level_area, 1e-9))

    @property
    def ceiling_behind_share(self) -> float:
        """Share of the level ground whose ceiling is seen from behind, 0..1."""
        return float(self.area[self.ceiling_behind].sum() / max(self.level_area, 1e-9))


def ground_of(
    grid: VoxelizedScene,
    voxels: np.ndarray,  # [X, Y, Z] bool, a part of the grid
    corner: Sequence[int] = (0, 0, 0),  # where the part begins
) -> Ground:
    """Find the surfaces below and above the vertical runs of some voxels, by one ray down and one up from each."""
    steps = np.diff(np.pad(voxels, ((0, 0), (0, 0), (1, 1))).astype(np.int8), axis=2)
    # Both in one order, as runs do not overlap.
    first, last = np.argwhere(steps == 1) + corner, np.argwhere(steps == -1) + corner - [0, 0, 1]
    lowest, highest = grid.centers(first), grid.centers(last)
    down, down_z = _cast(grid, lowest, -1.0)
    up, up_z = _cast(grid, highest, 1.0)
    below, above = lowest[:, 2] - down, highest[:, 2] + up
    half = 0.5 * grid.voxel_size
    # The part of the camera's heights that lies in the run.
    reached = np.minimum(below + CAMERA_HEIGHTS[1], highest[:, 2] + half) - np.maximum(
        below + CAMERA_HEIGHTS[0], lowest[:, 2] - half
    )
    share = np.clip(np.where(np.isfinite(below), reached, 0.0) / (CAMERA_HEIGHTS[1] - CAMERA_HEIGHTS[0]), 0.0, 1.0)
    return Ground(
        columns=first[:, :2],
        below=below,
        above=above,
        area=share * (np.abs(down_z) >= _LEVEL) * grid.voxel_size**2,
        floor_behind=down_z <= -_LEVEL,  # its normal points down, away from the region
        ceiling_behind=up_z >= _LEVEL,
    )


def front_share(grid: VoxelizedScene, places: np.ndarray) -> float:  # [N, 3] voxels -> 0..1
    """Return the share of rays that meet a surface from its front, out of those that meet one at all.

    Within a solid body all surfaces are seen from behind; a mesh without consistent winding has about a half.
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
    """Distance of the surface below (way -1) or above (1) each point, and the z of its normal, 0 where none is met."""
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
    """The weighted median of the values that have a weight."""
    values, weights = values[weights > 0], weights[weights > 0]
    if not len(values):
        return None
    order = np.argsort(values, kind="stable")
    cumulated = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(cumulated, 0.5 * cumulated[-1])])
