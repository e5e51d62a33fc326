"""The space of a scene in which an agent fits: ground truth from the mesh, for start poses, rewards and tests.

A mesh from the world is neither closed nor consistently oriented, so inside and outside are told apart by what one
would see: a place is enclosed when most directions meet a surface, and the free space is the largest connected
enclosed region with room for a body. Closed furniture is enclosed too, but never the largest region.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import fibonacci_directions
from activestructure_gym.ground_truth.surface_samples import lattice_samples, samples_per_area, surface_area
from activestructure_gym.scenes.scene import Scene

VOXEL_SIZE = 0.1  # metres; the size the planners' volumes use
MAX_VOXELS = 4_000_000  # 5 seconds of one core; a larger building gets larger voxels
MAX_SAMPLES = 8_000_000  # of the surface, 1.5 GB; one of 20,000 m2 and more gets larger voxels too
_SPACING = 0.7  # of the surface's samples, in voxels
BODY_CLEARANCE = 0.2  # metres; the smallest clearance a path may have (motion.MotionConfig.min_clearance)
MIN_VOLUME = 0.5  # cubic metres of free space; less is no room
# Share of directions that must meet a surface. A room without ceiling has about 0.78 at eye height, a room with a
# glass front 0.95, a place outside beside a wall at most 0.75 (ground and wall, half of all directions each).
ENCLOSED_SHARES = (0.75, 0.6)  # the second is for wide open-topped scans, where the first finds nothing
_DIRECTIONS = 64
_EXACT_BELOW = 0.6  # metres; above the largest clearance that anything asks for (start poses: 0.45)


@dataclass(frozen=True)
class FreeSpace:
    """The free region of a scene on a grid; voxel (i, j, k) has its centre at ``origin + (i + .5, ...) * size``."""

    origin: np.ndarray  # [3] float64 metres: lower corner of the grid
    voxel_size: float  # metres
    clearance: np.ndarray  # [X, Y, Z] float32 metres from voxel centre to the nearest surface, 0 = not free
    height: np.ndarray  # [X, Y, Z] float32 metres above the surface below, 0 = not free, inf = nothing below
    start_poses: np.ndarray  # [S, 4, 4] float64 world_from_camera: spread over the scene, standing free, looking level

    @property
    def volume(self) -> float:
        """Cubic metres of free space."""
        return float(np.count_nonzero(self.clearance)) * self.voxel_size**3

    @cached_property
    def free_voxels(self) -> np.ndarray:  # [N, 3]
        """Indices of the free voxels."""
        return np.argwhere(self.clearance > 0)

    def centers(self, voxels: np.ndarray) -> np.ndarray:  # [..., 3] indices -> [..., 3] metres
        """World positions of voxel centres."""
        return self.origin + (np.asarray(voxels) + 0.5) * self.voxel_size

    def clearance_at(self, points: np.ndarray) -> np.ndarray:  # [N, 3] metres -> [N] float32 metres
        """Clearance between voxel centres, trilinear; 0 outside the free space."""
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
        """Positions uniform over the free space that satisfy both limits.

        Raises `InputError` where the scene has no such place.
        """
        fits = self.clearance >= min_clearance
        if heights is not None:
            fits &= (self.height >= heights[0]) & (self.height <= heights[1])
        voxels = np.argwhere(fits)
        if not len(voxels):
            limits = f"a clearance of {min_clearance} m" + (f" and a height of {heights} m" if heights else "")
            raise InputError(f"the scene has no free place with {limits}; lower the limits")
        positions = self.centers(voxels[rng.integers(len(voxels), size=count)])
        # Move each within its voxel where that keeps the clearance; the centre always does.
        jitter = (rng.random((4, count, 3)) - 0.5) * self.voxel_size
        moved = np.zeros(count, dtype=bool)
        for offset in jitter:
            attempt = positions + offset
            good = ~moved & (self.clearance_at(attempt) >= min_clearance)
            positions[good] = attempt[good]
            moved |= good
        return positions


def compute_free_space(scene: Scene) -> FreeSpace:
    """The free space of a scene, still without start poses. Raises `InputError` where none is found."""
    origin, voxel_size, shape = _grid(scene.bounds, surface_area(scene.mesh.vertices, scene.mesh.faces))
    # Every point of the surface has a sample within half a voxel: a voxel that a surface properly crosses is never
    # empty, and at the body's clearance the nearest sample is at most 6 mm farther than the surface.
    surface = lattice_samples(scene.mesh.vertices, scene.mesh.faces, _SPACING * voxel_size)
    occupied = np.zeros(shape, dtype=bool)
    occupied[tuple(np.floor((surface - origin) / voxel_size).astype(np.int64).T)] = True
    share = enclosed_share(occupied)
    for threshold in ENCLOSED_SHARES:
        candidates = ~occupied & (share >= threshold)
        clearance = _clearance(candidates, surface, origin, voxel_size)
        clearance = _largest_region(candidates, clearance, voxel_size)
        if np.count_nonzero(clearance) * voxel_size**3 >= MIN_VOLUME:
            break
    else:
        raise InputError(
            f"scene '{scene.name}' has no free space: no region of {MIN_VOLUME} m^3 that is enclosed by surfaces and "
            f"{BODY_CLEARANCE} m away from them; a scene is rooms seen from inside, with walls, floor and ceiling: "
            "check its units and up axis"
        )
    height = _heights(scene, clearance, origin, voxel_size)
    return FreeSpace(origin, voxel_size, clearance, height, np.zeros((0, 4, 4)))


def _grid(bounds: np.ndarray, area: float) -> tuple[np.ndarray, float, tuple[int, int, int]]:
    """Lower corner, voxel size and shape of a grid around the bounds, with a voxel to spare on every side."""
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
    """Share of directions in which a voxel of the grid is occupied, for every voxel.

    One sweep per direction over the layers of the grid: a voxel sees a surface where the next voxel along the
    direction is occupied or sees one itself. Far cheaper than rays, and a direction is all that is asked for.
    """
    seen = np.zeros(occupied.shape, dtype=np.uint8)
    for direction in fibonacci_directions(_DIRECTIONS):
        axis = int(np.abs(direction).argmax())
        # Views with the sweep axis first and the direction ascending along it; writing to them writes to `seen`.
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
    """``result[x] = layer[x + step]``, False beyond the border."""
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
    """Distance from the centres of the candidates to the surface, 0 elsewhere. [X, Y, Z] float32

    Near the surface, where it decides what a body can do, from the nearest sample; farther away from the mean of the
    samples in the nearest occupied voxel (at most 0.12 m too much, 1 to 3 mm in the median), which is 5 times faster.
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
    # Unbalanced, uncompacted trees build three times faster and answer alike on points this regular.
    tree = cKDTree(surface, balanced_tree=False, compact_nodes=False)
    exact = tree.query(centers[near], distance_upper_bound=_EXACT_BELOW + voxel_size, workers=2)[0]
    distance[near] = np.minimum(exact, _EXACT_BELOW + voxel_size)
    clearance[candidates] = distance
    return clearance


def _largest_region(candidates: np.ndarray, clearance: np.ndarray, voxel_size: float) -> np.ndarray:
    """The clearance of the largest region a body can move in, 0 everywhere else."""
    from scipy import ndimage

    # Two neighbouring voxels on both sides of a wall cannot both be this far from it, however thin it is.
    core = candidates & (clearance >= max(BODY_CLEARANCE, 0.6 * voxel_size))
    regions, count = ndimage.label(core)
    if not count:
        return np.zeros_like(clearance)
    core = regions == np.bincount(regions.ravel())[1:].argmax() + 1
    # Back to the walls: what the body covers when its centre is in the core.
    steps = max(1, round(BODY_CLEARANCE / voxel_size))
    region = ndimage.binary_dilation(core, iterations=steps, mask=candidates)
    return np.where(region, clearance, np.float32(0.0))


def _heights(scene: Scene, clearance: np.ndarray, origin: np.ndarray, voxel_size: float) -> np.ndarray:
    height = np.zeros_like(clearance)
    free = clearance > 0
    centers = origin + (np.argwhere(free) + 0.5) * voxel_size
    height[free] = scene.raycaster.cast(centers, np.broadcast_to([0.0, 0.0, -1.0], centers.shape)).distance
    return height
