"""Voxelise a scene: occupied voxels, share of directions that hit a surface, and distance to the surface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from activestructure_gym.geometry import fibonacci_directions
from activestructure_gym.ground_truth.surface_samples import lattice_samples, samples_per_area, surface_area
from activestructure_gym.scenes.scene import Scene

VOXEL_SIZE = 0.1  # metres; the planners' volumes use the same size
MAX_VOXELS = 4_000_000  # maximum number of voxels, 5 seconds on one core; larger buildings get larger voxels
MAX_SAMPLES = 8_000_000  # maximum number of surface samples, 1.5 GB; surfaces above 20,000 m^2 get larger voxels
_SPACING = 0.7  # spacing of the surface samples, in voxels
_DIRECTIONS = 64  # number of directions of `enclosed_share`
_EXACT_BELOW = 0.6  # metres; clearances below it are exact, and no larger one is required (start poses: 0.6)


@dataclass(frozen=True, eq=False)
class VoxelizedScene:
    """Hold a scene's surface on a grid; voxel (i, j, k) has its centre at ``origin + (i + 0.5, ...) * voxel_size``."""

    scene: Scene
    origin: np.ndarray  # [3] float64 metres: lower corner of the grid
    voxel_size: float  # metres
    surface: np.ndarray  # [S, 3] float64 metres: sample points on the surface
    occupied: np.ndarray  # [X, Y, Z] bool: whether the voxel contains a sample point

    @cached_property
    def share(self) -> np.ndarray:  # [X, Y, Z] float32
        """Return the fraction of directions that hit a surface, for every voxel."""
        return enclosed_share(self.occupied)

    def clearance(self, candidates: np.ndarray) -> np.ndarray:  # [X, Y, Z] bool -> [X, Y, Z] float32 metres
        """Return the distance from the centre of each voxel in ``candidates`` to the surface; 0 in other voxels."""
        return _clearance(candidates, self.surface, self.origin, self.voxel_size)

    def centers(self, voxels: np.ndarray) -> np.ndarray:  # [..., 3] indices -> [..., 3] metres
        """Return the world positions of voxel centres."""
        return self.origin + (np.asarray(voxels) + 0.5) * self.voxel_size

    def voxel_of(self, point: np.ndarray) -> np.ndarray:  # [3] metres -> [3] int64
        """Return the index of the voxel that contains a point; it can be outside the grid."""
        return np.floor((np.asarray(point, dtype=np.float64) - self.origin) / self.voxel_size).astype(np.int64)


def voxelized(scene: Scene) -> VoxelizedScene:
    """Voxelise a scene; the voxel size is 0.1 m, or larger if `MAX_VOXELS` or `MAX_SAMPLES` would be exceeded."""
    origin, voxel_size, shape = _grid(scene.bounds, surface_area(scene.mesh.vertices, scene.mesh.faces))
    # Every surface point has a sample within half a voxel, so a voxel that a surface clearly crosses is never empty. At
    # a distance of 0.2 m from the surface, the nearest sample is at most 6 mm farther than the surface.
    surface = lattice_samples(scene.mesh.vertices, scene.mesh.faces, _SPACING * voxel_size)
    occupied = np.zeros(shape, dtype=bool)
    occupied[tuple(np.floor((surface - origin) / voxel_size).astype(np.int64).T)] = True
    return VoxelizedScene(scene, origin, voxel_size, surface, occupied)


def _grid(bounds: np.ndarray, area: float) -> tuple[np.ndarray, float, tuple[int, int, int]]:
    """Return lower corner [3], voxel size and shape of a grid around ``bounds`` [2, 3], all in metres.

    The grid has one spare voxel on each side. ``area`` is the area of the surface in m^2.
    """
    extent = bounds[1] - bounds[0]
    voxel_size = VOXEL_SIZE
    while (
        np.prod(np.ceil(extent / voxel_size) + 2) > MAX_VOXELS
        or samples_per_area(_SPACING * voxel_size) * area > MAX_SAMPLES
    ):
        voxel_size *= 1.1
    x, y, z = (np.ceil(extent / voxel_size) + 2).astype(int)
    centre = 0.5 * (bounds[0] + bounds[1])
    return centre - 0.5 * voxel_size * np.array([x, y, z]), voxel_size, (int(x), int(y), int(z))


def enclosed_share(occupied: np.ndarray) -> np.ndarray:  # [X, Y, Z] bool -> [X, Y, Z] float32
    """Return, for every voxel, the fraction of 64 directions in which it sees an occupied voxel of the grid.

    There is one sweep over the layers of the grid per direction. A voxel sees a surface if the next voxel along the
    direction is occupied or sees a surface itself. This is much cheaper than casting rays.
    """
    seen = np.zeros(occupied.shape, dtype=np.uint8)
    for direction in fibonacci_directions(_DIRECTIONS):
        axis = int(np.abs(direction).argmax())
        # Array views with the sweep axis first, ascending along the direction. Writing to `counts` changes `seen`.
        layers, counts = np.moveaxis(occupied, axis, 0), np.moveaxis(seen, axis, 0)
        if direction[axis] < 0:
            layers, counts = layers[::-1], counts[::-1]
        slope = np.delete(direction, axis) / abs(direction[axis])
        # The line through a voxel, rounded to whole voxels per layer: steps of -1, 0 or 1.
        steps = np.diff(np.round(np.arange(len(layers))[:, None] * slope), axis=0).astype(int)
        hit = np.zeros(layers.shape[1:], dtype=bool)
        for index in range(len(layers) - 2, -1, -1):
            hit = _shifted(layers[index + 1] | hit, steps[index])
            counts[index] += hit
    return seen.astype(np.float32) / _DIRECTIONS


def _shifted(layer: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Return the layer [A, B] shifted by ``step`` [2] voxels: ``result[x] = layer[x + step]``, False outside."""
    if not step.any():
        return layer
    result = np.zeros_like(layer)
    target, source = [], []
    for size, offset in zip(layer.shape, step):
        target.append(slice(max(0, -offset), size - max(0, offset)))
        source.append(slice(max(0, offset), size - max(0, -offset)))
    result[tuple(target)] = layer[tuple(source)]
    return result


def _clearance(candidates: np.ndarray, surface: np.ndarray, origin: np.ndarray, voxel_size: float) -> np.ndarray:
    """Return the distance [X, Y, Z] from the centres of ``candidates`` to the surface in metres, 0 in other voxels.

    Near the surface it is the distance to the nearest sample of ``surface``. Beyond 0.6 m it is the distance to the
    mean of the samples in the nearest occupied voxel. This is 5 times faster; the median error is 1 to 3 mm, and the
    result is at most 0.12 m too large.
    """
    from scipy.ndimage import distance_transform_edt
    from scipy.spatial import cKDTree

    clearance = np.zeros(candidates.shape, dtype=np.float32)
    if not candidates.any():
        return clearance
    flat = np.ravel_multi_index(tuple(np.floor((surface - origin) / voxel_size).astype(np.int64).T), candidates.shape)
    samples = np.bincount(flat, minlength=candidates.size)
    sums = np.stack([np.bincount(flat, surface[:, k], candidates.size) for k in range(3)], axis=1)
    means = sums / np.maximum(samples, 1)[:, None]
    empty = (samples == 0).reshape(candidates.shape)
    nearest = distance_transform_edt(empty, return_distances=False, return_indices=True)[:, candidates]
    centers = origin + (np.argwhere(candidates) + 0.5) * voxel_size
    distance = np.linalg.norm(centers - means[np.ravel_multi_index(tuple(nearest), candidates.shape)], axis=1)
    near = distance < _EXACT_BELOW
    # Unbalanced, uncompacted trees build three times faster, with equal query time on such regular points.
    tree = cKDTree(surface, balanced_tree=False, compact_nodes=False)
    exact = tree.query(centers[near], distance_upper_bound=_EXACT_BELOW + voxel_size, workers=2)[0]
    distance[near] = np.minimum(exact, _EXACT_BELOW + voxel_size)
    clearance[candidates] = distance
    return clearance
