"""Fuse depth images into a triangle surface by truncated signed distances (TSDF) on sparse blocks of voxels.

Source: [curless1996], with distances measured along the optical axis and equal weights. A block has 8 x 8 x 8 voxels.
Only blocks near a measured surface are stored. Every image that observes a stored block is integrated into it.

The blocks are fused in parts to bound the memory. Each part also contains the next blocks in positive x, y and z: their
first voxels complete the cells at the border. So there are no cracks between parts, and every triangle belongs to
exactly one part.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.machine.threads import thread_cap
from activestructure_gym.evaluation.metrics.fusion_kernels import (
    SIDE,
    Blocks,
    areas_of,
    integrate,
    mark_blocks,
    range_of_tiles,
    span,
    triangles,
)
from activestructure_gym.geometry import PinholeCamera, invert_rigid

MAX_BLOCKS = 20_000_000  # limit of stored blocks: 160 MB of keys, about 290,000 m^2 with voxels of 2 cm cut at 6 cm
_ROOM = 320  # triangles per block in the initial buffer: enough for an oblique plane through the block
_CHUNK = 64  # blocks per task of a thread
_PIECE = 32 * _CHUNK  # maximum number of blocks whose triangles `pieces` yields in one array (30 MB)
_PART = 50_000  # maximum number of blocks fused at a time (200 MB), without their neighbours
_IMAGES = 64  # images read or rendered at a time
_KEPT_IMAGES = 256 << 20  # bytes; if the images need more, they are rendered again for every part
_KEPT_TRIANGLES = 512 << 20  # bytes; if the triangles need more, they are computed again at each call of `pieces`
_MAX_CELLS = 20_000_000  # maximum number of blocks in the bounding box of one image; more means invalid depths
_BITS = 21  # bits per axis in the integer key of a block, see `_keys_of`

# Offsets of the block itself and its 7 neighbours in positive x, y and z.
_AFTER = np.array([[i >> 2, i >> 1 & 1, i & 1] for i in range(8)])


class FusedSurface:
    """Fuse depth images and extract the zero level of the fused distances as triangles.

    Only voxel cells whose eight corners were measured contain triangles.

    Parameters
    ----------
    draw
        Function that returns the depth images [n, H, W] float32 at poses [n, 4, 4] world_from_camera: metres along the
        optical axis, 0 = no surface. It is called repeatedly for the same poses if all images together are too large to
        keep.
    camera
        The camera of all images.
    world_from_camera
        [K, 4, 4] poses of all images, metres.
    voxel
        Side length of a voxel in metres.
    truncation
        Truncation distance in metres; larger distances count as this distance.

    Raises
    ------
    InputError
        The images cover a larger region than can be fused.
    """

    def __init__(
        self,
        draw: Callable[[np.ndarray], np.ndarray],
        camera: PinholeCamera,
        world_from_camera: np.ndarray,
        *,
        voxel: float,
        truncation: float,
    ) -> None:
        self._draw, self._camera, self._voxel, self._truncation = draw, camera, voxel, truncation
        self._intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        self._poses = np.ascontiguousarray(world_from_camera, np.float64)
        self._camera_from_world = np.ascontiguousarray(invert_rigid(self._poses)[:, :3])
        self._images: np.ndarray | None = None
        if 4 * len(self._poses) * camera.height * camera.width <= _KEPT_IMAGES:
            self._images = np.ascontiguousarray(draw(self._poses), np.float32)
        # [K, 2, 3] metres: lower and upper corner of the box around the measured points of every image
        self._bounds = np.tile([[[np.inf] * 3, [-np.inf] * 3]], (len(self._poses), 1, 1))
        self._keys = self._marked()  # [B] sorted
        self._pieces: list[np.ndarray] | None = None

    @property
    def blocks(self) -> int:
        """Return the number of stored blocks of 8 x 8 x 8 voxels."""
        return len(self._keys)

    def oriented(self) -> np.ndarray:  # [T, 3, 3] float32 metres
        """Return the corners of all triangles, counter-clockwise seen from the free side of the surface."""
        starts = range(0, len(self._keys), _PART)
        parts = [piece for start in starts for piece in self._part(self._keys[start : start + _PART], oriented=True)]
        return np.concatenate([*parts, np.empty((0, 3, 3), np.float32)])

    def pieces(self) -> Iterator[np.ndarray]:  # [T, 3, 3] float32 metres, the corners of triangles
        """Yield the corners of the triangles in world coordinates, in arrays for at most 2,048 blocks.

        The triangles are ordered by the keys of their blocks. Every call yields the same arrays.
        """
        if self._pieces is not None:
            yield from self._pieces
            return
        kept, size = list[np.ndarray](), 0
        for start in range(0, len(self._keys), _PART):
            for piece in self._part(self._keys[start : start + _PART]):
                size += piece.nbytes
                if size <= _KEPT_TRIANGLES:
                    kept.append(piece)
                else:
                    kept.clear()
                yield piece
        if size <= _KEPT_TRIANGLES:
            self._pieces = kept

    def _marked(self) -> np.ndarray:  # [B] int64
        """Return the sorted keys of all blocks within the truncation distance of a measured point, along its ray.

        Also compute ``_bounds``, the bounding box of every image.
        """
        keys = np.zeros(0, np.int64)
        for first in range(0, len(self._poses), _IMAGES):
            images = np.arange(first, min(first + _IMAGES, len(self._poses)))
            depth, bounds = self._depth(images), self._bounds[first : first + _IMAGES]
            span(depth, self._intrinsics, self._poses[images], self._truncation, bounds)
            keys = np.union1d(keys, self._marked_by(depth, images))
            if len(keys) > MAX_BLOCKS:
                raise InputError(
                    f"the surface needs more than {MAX_BLOCKS:,} blocks of {SIDE} x {SIDE} x {SIDE} voxels of "
                    f"{self._voxel} m"
                )
        return keys

    def _marked_by(self, depth: np.ndarray, images: np.ndarray) -> np.ndarray:  # [n] int64
        """Return the keys of the blocks near the measured points of some images.

        ``depth`` [n, H, W] holds the images in metres, and ``images`` [n] their indices. If they cover distant places,
        the images are split into halves, so that no large grid of blocks is allocated.
        """
        seen = np.isfinite(self._bounds[images]).all(axis=(1, 2))
        depth, images = depth[seen], images[seen]
        if not len(images):
            return np.zeros(0, np.int64)
        block = SIDE * self._voxel
        low, high = self._bounds[images, 0].min(axis=0), self._bounds[images, 1].max(axis=0)
        first = np.floor(low / block).astype(np.int64) - 1  # one more block, against rounding
        shape = np.floor(high / block) - first + 2.0
        if float(shape.prod()) > _MAX_CELLS or np.abs([low, high]).max() / block >= 2 ** (_BITS - 1) - 2:
            if len(images) == 1:
                raise InputError(
                    f"a depth image spans {(high - low).round(1)} m, too much to fuse; check that depth is in metres"
                )
            half = len(images) // 2
            parts = [self._marked_by(depth[part], images[part]) for part in (slice(half), slice(half, None))]
            return np.concatenate(parts)
        marked = np.zeros(tuple(shape.astype(int)), np.bool_)
        mark_blocks(depth, self._intrinsics, self._poses[images], self._truncation, first, block, marked)
        return _keys_of(np.argwhere(marked) + first)

    def _depth(self, images: np.ndarray) -> np.ndarray:  # [n, H, W] float32 metres
        if self._images is not None:
            return self._images[images]
        return np.ascontiguousarray(self._draw(self._poses[images]), np.float32)

    def _part(self, own: np.ndarray, *, oriented: bool = False) -> Iterator[np.ndarray]:
        """Fuse the blocks with the keys ``own`` [n] and yield their triangles in arrays [T, 3, 3], metres."""
        after = own[:, None] + _keys_of(_AFTER, about=0)  # [n, 8]
        keys = np.unique(after[_rows_of(after, self._keys) >= 0])
        rows = _rows_of(after, keys)
        # The origin is a multiple of the block size, so the voxel grid is the same for all sets of images.
        block = SIDE * self._voxel
        first = np.floor(self._bounds[:, 0].min(axis=0) / block).astype(np.int64) - 1
        origin, places = first * block, _places_of(keys) - first
        fused = Blocks(places, *(np.zeros((len(keys), SIDE, SIDE, SIDE), np.float32) for _ in range(2)))
        shown = places[rows[:, 0]]

        def extract(start: int) -> np.ndarray:
            part = slice(start, start + _CHUNK)
            rest = rows[part], shown[part], origin, self._voxel, oriented
            corners = np.empty((_ROOM * len(shown[part]), 3, 3), np.float32)
            count = triangles(fused.distance, fused.weight, *rest, corners)
            if count > len(corners):
                corners = np.empty((count, 3, 3), np.float32)
                triangles(fused.distance, fused.weight, *rest, corners)
            return corners[:count]

        with ThreadPoolExecutor(max(1, min(thread_cap(), -(-len(keys) // _CHUNK)))) as pool:
            self._integrate(fused, origin, pool)
            for piece in range(0, len(own), _PIECE):
                starts = range(piece, min(piece + _PIECE, len(own)), _CHUNK)
                yield np.concatenate(list(pool.map(extract, starts)))

    def _integrate(self, fused: Blocks, origin: np.ndarray, pool: ThreadPoolExecutor) -> None:
        """Add the measurements of all images that can observe the blocks to ``fused``.

        ``origin`` [3] is the world position in metres of the lower corner of the block with index (0, 0, 0).
        """
        block = SIDE * self._voxel
        low, high = origin + fused.places.min(axis=0) * block, origin + (fused.places.max(axis=0) + 1) * block
        near = np.flatnonzero(self._reaches(low, high))
        for number in range(0, len(near), _IMAGES):
            images = near[number : number + _IMAGES]
            depth = self._depth(images)
            tiles, poses = range_of_tiles(depth), self._camera_from_world[images]

            rest = self._intrinsics, poses, origin, self._voxel, self._truncation
            own = (
                Blocks(*(array[start : start + _CHUNK] for array in fused))
                for start in range(0, len(fused.places), _CHUNK)
            )
            list(pool.map(partial(integrate, depth, tiles, *rest), own))

    def _reaches(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:  # [K] bool
        """Return which images can observe a box with the corners ``low`` and ``high`` [3], metres, world.

        The box must meet the bounding box of the image's camera centre and measured points.
        """
        eyes = self._poses[:, :3, 3]
        lower, upper = np.minimum(self._bounds[:, 0], eyes), np.maximum(self._bounds[:, 1], eyes)
        # Upper bound in metres on the width of a pixel at the farthest point. The bounds contain the centres of the
        # pixels only, so half a pixel may be outside.
        wide = np.linalg.norm(upper - lower, axis=1) / min(self._camera.fx, self._camera.fy)
        spare = (SIDE * self._voxel + wide)[:, None]
        return np.isfinite(self._bounds).all(axis=(1, 2)) & ((lower - spare <= high) & (upper + spare >= low)).all(
            axis=1
        )


def check_fusing(scene: str, area: float, voxel: float, truncation: float) -> None:
    """Raise `InputError` if a completely observed surface of ``area`` m^2 needs more than `MAX_BLOCKS` blocks.

    ``scene`` is its name for the message; ``voxel`` and ``truncation`` are in metres.
    """
    blocks = _blocks_for(area, voxel, truncation)
    if blocks <= MAX_BLOCKS:
        return
    wider = voxel
    while _blocks_for(area, wider, max(truncation, wider)) > MAX_BLOCKS:
        wider *= 1.1
    raise InputError(
        f"the {area:,.0f} m2 of surface in scene '{scene}' need about {blocks:,.0f} blocks of voxels of {voxel} m, and "
        f"at most {MAX_BLOCKS:,} are fused: choose a tsdf_voxel_m of at least {math.ceil(1000 * wider) / 1000:g}, or "
        "'means' as points_source"
    )


def _blocks_for(area: float, voxel: float, truncation: float) -> float:
    """Return the approximate number of blocks within ``truncation`` metres of a surface of ``area`` m^2."""
    block = SIDE * voxel
    return area / block**2 * (1.0 + 2.0 * truncation / block)


def triangle_areas(corners: np.ndarray) -> np.ndarray:  # [T] m^2
    """Return the area of each triangle of ``corners`` [T, 3, 3] metres."""
    areas = np.empty(len(corners))
    areas_of(np.ascontiguousarray(corners), areas)
    return areas


def _keys_of(places: np.ndarray, about: int = 1 << (_BITS - 1)) -> np.ndarray:  # [..., 3] -> [...] int64
    """Return one integer key per block index (x, y, z) with 21 bits per axis; keys sort by x, then y, then z.

    ``about`` is added to each coordinate, so that negative indices have keys. With 0 the result is the difference of
    two keys whose indices differ by ``places``.
    """
    x, y, z = np.moveaxis(places + about, -1, 0)
    return (x << 2 * _BITS) + (y << _BITS) + z


def _rows_of(wanted: np.ndarray, keys: np.ndarray) -> np.ndarray:  # [...], [N] rising -> [...] int32
    """Return the row of each ``wanted`` key in the sorted ``keys``, -1 for missing keys."""
    rows = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1).astype(np.int32)
    return np.where(keys[rows] == wanted, rows, np.int32(-1))


def _places_of(keys: np.ndarray) -> np.ndarray:  # [N] -> [N, 3] int64
    """Return the block indices (x, y, z) of integer keys; the inverse of `_keys_of`."""
    mask = (1 << _BITS) - 1
    return np.stack([keys >> 2 * _BITS, keys >> _BITS & mask, keys & mask], axis=1) - (1 << (_BITS - 1))
