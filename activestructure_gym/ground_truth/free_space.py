"""Represent the space of a scene in which an agent fits, computed from the mesh for start poses, rewards and tests."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.ground_truth.regions import Region, Regions
from activestructure_gym.scenes.scene import Scene


@dataclass(frozen=True)
class FreeSpace:
    """Hold the free region of a scene that the agent uses, on a voxel grid.

    Voxel (i, j, k) has its centre at ``origin + (i + 0.5, j + 0.5, k + 0.5) * voxel_size``.
    """

    origin: np.ndarray  # [3] float64 metres: lower corner of the grid
    voxel_size: float  # metres
    clearance: np.ndarray  # [X, Y, Z] float32 metres from voxel centre to the nearest surface, 0 = not free
    height: np.ndarray  # [X, Y, Z] float32 metres above the surface below, 0 = not free, inf = nothing below
    start_poses: np.ndarray  # [S, 4, 4] float64 world_from_camera: spread over the scene, collision-free, level

    @property
    def volume(self) -> float:
        """Return the free space in cubic metres."""
        return float(np.count_nonzero(self.clearance)) * self.voxel_size**3

    @cached_property
    def free_voxels(self) -> np.ndarray:  # [N, 3]
        """Return the indices of the free voxels."""
        return np.argwhere(self.clearance > 0)

    def centers(self, voxels: np.ndarray) -> np.ndarray:  # [..., 3] indices -> [..., 3] metres
        """Return the world positions of voxel centres."""
        return self.origin + (np.asarray(voxels) + 0.5) * self.voxel_size

    def clearance_at(self, points: np.ndarray) -> np.ndarray:  # [N, 3] metres -> [N] float32 metres
        """Return the clearance at each point, interpolated trilinearly between voxel centres; 0 outside free space."""
        from scipy.ndimage import map_coordinates

        positions = (np.asarray(points, dtype=np.float64).reshape(-1, 3) - self.origin) / self.voxel_size - 0.5
        return map_coordinates(self.clearance, positions.T, order=1, mode="constant", cval=0.0, output=np.float32)

    def sample_positions(
        self,
        count: int,
        rng: np.random.Generator,
        *,
        min_clearance: float = 0.3,  # metres
        heights: tuple[float, float] | None = None,  # metres above the surface below
    ) -> np.ndarray:  # [count, 3] metres
        """Return random positions, uniform over the free space with enough clearance and a height within ``heights``.

        Raises `InputError` if the scene has no such position.
        """
        fits = self.clearance >= min_clearance
        if heights is not None:
            fits &= (self.height >= heights[0]) & (self.height <= heights[1])
        voxels = np.argwhere(fits)
        if not len(voxels):
            limits = f"a clearance of {min_clearance} m" + (f" and a height of {heights} m" if heights else "")
            raise InputError(f"the scene has no free place with {limits}; lower the limits")
        positions = self.centers(voxels[rng.integers(len(voxels), size=count)])
        # Move each position randomly within its voxel if the clearance remains large enough, in up to four tries.
        jitter = (rng.random((4, count, 3)) - 0.5) * self.voxel_size
        moved = np.zeros(count, dtype=bool)
        for offset in jitter:
            attempt = positions + offset
            good = ~moved & (self.clearance_at(attempt) >= min_clearance)
            positions[good] = attempt[good]
            moved |= good
        return positions


def compute_free_space(scene: Scene, regions: Regions | None = None) -> FreeSpace:
    """Compute the free space of a scene, without start poses; ``regions`` are its regions if known already.

    Raises `InputError` if there is none.
    """
    return free_space_in((regions or Regions(scene)).used)


def free_space_in(region: Region) -> FreeSpace:
    """Return the free space of a region: clearance and height above the ground of its voxels, without start poses."""
    grid, clearance = region.grid, region.clearance
    height = _heights(grid.scene, clearance, grid.origin, grid.voxel_size)
    return FreeSpace(grid.origin, grid.voxel_size, clearance, height, np.zeros((0, 4, 4)))


def _heights(scene: Scene, clearance: np.ndarray, origin: np.ndarray, voxel_size: float) -> np.ndarray:
    height = np.zeros_like(clearance)
    free = clearance > 0
    centers = origin + (np.argwhere(free) + 0.5) * voxel_size
    height[free] = scene.raycaster.cast(centers, np.broadcast_to([0.0, 0.0, -1.0], centers.shape)).distance
    return height
