"""Find the part of a large map inside the view frustum of a camera, so that rendering does not read the whole map.

Consecutive Gaussians in the arrays were mostly inserted together and are close in space. Each block of them has a
bounding box. Blocks are left out if their box does not reach the image. The other blocks are copied into one array. The
bound is not tighter than that of the rasteriser, so images are equal bit for bit. With a measured depth, occluded
blocks can be left out too (`activestructure_gym.mapping.occlusion_culling`).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry import PinholeCamera, invert_rigid
from activestructure_gym.mapping.boxes import BLOCK, block_boxes
from activestructure_gym.mapping.gaussian_map import ROWS, GaussianMap
from activestructure_gym.mapping.occlusion_culling import behind_the_measured, depth_tiles
from activestructure_gym.splatting import layout
from activestructure_gym.splatting.workspace import aligned_zeros, make_view

_MIN_BLOCKS = 64  # a map with at most this number of blocks is always rendered as a whole
_MAX_SHARE = 0.5  # if a larger share of the blocks is in view, copying costs more than it saves
_LANES = 16  # vector width of the processor; the capacity of a map is a multiple of it
_REACH = 3.35  # radius of a Gaussian in sigmas (the rasteriser stops at 3.34)
_BLUR_PIXELS = 2.0  # the rasteriser's blur of 0.3 px^2 enlarges Gaussians by 3.34 sqrt(0.3) = 1.83 pixels


class MapParts:
    """Hold bounding boxes of the blocks of a map, for the map at the time of construction.

    They remain valid while no Gaussian moves by more than ``shift`` metres or grows by more than the factor ``growth``.
    With ``kept``, the boxes stored in the map are used (`GaussianMap.boxes`). These are correct if all changes of the
    map were reported by `GaussianMap.touched`.
    """

    def __init__(self, gaussians: GaussianMap, *, shift: float = 0.0, growth: float = 1.0, kept: bool = False) -> None:
        self._map = gaussians
        self._boxes: np.ndarray | None = None  # [B, 7], see `block_boxes`; None for a small map
        if gaussians.count > _MIN_BLOCKS * BLOCK and bool(np.isfinite([shift, growth]).all()):
            boxes = gaussians.boxes() if kept else block_boxes(gaussians.parameters, gaussians.count)
            scale = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, growth])
            self._boxes = boxes * scale + np.array([-shift, -shift, -shift, shift, shift, shift, 0.0])

    def unseen(
        self,
        camera: PinholeCamera,
        world_from_camera: np.ndarray,  # [4, 4]
        depth: np.ndarray | None = None,  # [H, W] float32 measured depth in metres, 0 = no return
    ) -> np.ndarray | None:  # [chunks] bool, one per 1024 Gaussians
        """Return a mask of the chunks of 1024 Gaussians that are completely outside the view frustum.

        None for a small map. With ``depth``, chunks occluded by the measured surface are included. Leaving these out
        can change the image slightly where the rendered surface is transparent.
        """
        if self._boxes is None:
            return None
        seen = may_be_seen(self._boxes, camera, world_from_camera)
        if depth is not None:
            candidates = np.flatnonzero(seen)
            tiles = depth_tiles(depth, camera, world_from_camera)
            seen[candidates] = ~behind_the_measured(self._boxes[candidates], tiles)
        per_chunk = layout.CHUNK // BLOCK
        padded = np.zeros(-(-len(seen) // per_chunk) * per_chunk, dtype=bool)
        padded[: len(seen)] = seen
        return np.logical_not(padded.reshape(-1, per_chunk).any(axis=1))

    def in_view(
        self,
        camera: PinholeCamera,
        world_from_camera: np.ndarray,  # [4, 4] or [C, 4, 4]
    ) -> tuple[np.ndarray, int]:  # parameters [14, capacity] float32, number of Gaussians
        """Return the Gaussians that can contribute to an image from one of these poses, in map order.

        The array is read-only: if most of the map is in view, it is the array of the map.
        """
        rows = self._map.parameters
        if self._boxes is None:
            return rows, self._map.count
        seen = np.zeros(len(self._boxes), dtype=bool)
        for pose in np.asarray(world_from_camera, dtype=np.float64).reshape(-1, 4, 4):
            seen |= may_be_seen(self._boxes, camera, pose)
            if seen.mean() > _MAX_SHARE:
                return rows, self._map.count
        edges = np.flatnonzero(np.diff(seen.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)
        runs = np.minimum(edges * BLOCK, self._map.count)
        count = int((runs[:, 1] - runs[:, 0]).sum())
        part = aligned_zeros(ROWS * max(_LANES, -(-count // _LANES) * _LANES)).reshape(ROWS, -1)
        at = 0
        for first, stop in runs:
            part[:, at : at + stop - first] = rows[:, first:stop]
            at += stop - first
        return part, count


def may_be_seen(
    boxes: np.ndarray,  # [B, 7], see `block_boxes`
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [4, 4]
) -> np.ndarray:  # [B] bool
    """Return True for each block unless its box is behind the camera or completely outside one side of the image."""
    sides, wider = _sides(camera)
    return _reaches(boxes, np.ascontiguousarray(sides @ invert_rigid(world_from_camera)), wider)


@lru_cache(64)
def _sides(camera: PinholeCamera) -> tuple[np.ndarray, float]:
    """Return the frustum planes of a camera at the origin, and the largest image radius of a Gaussian of 1 m.

    The planes [5, 4] are the four sides of the image and the plane z = 0. A point (x, y, z, 1) is inside if its product
    with each plane is at least 0. The radius is in pixels, for a sigma of 1 m at a depth of 1 m.
    """
    view = make_view(camera, np.eye(4))
    slope_x = max(abs(view[layout.LOW_X]), abs(view[layout.HIGH_X]))
    slope_y = max(abs(view[layout.LOW_Y]), abs(view[layout.HIGH_Y]))
    # Upper bound of the norm of (Jacobian of the projection) times depth, for the slopes allowed by the rasteriser.
    stretch = np.sqrt(camera.fx**2 * (1.0 + slope_x**2) + camera.fy**2 * (1.0 + slope_y**2))
    border = _BLUR_PIXELS
    sides = np.array([
        [camera.fx, 0.0, camera.cx + border, 0.0],
        [-camera.fx, 0.0, camera.width + border - camera.cx, 0.0],
        [0.0, camera.fy, camera.cy + border, 0.0],
        [0.0, -camera.fy, camera.height + border - camera.cy, 0.0],
        [0.0, 0.0, 1.0, 0.0],
    ])  # fmt: skip
    return sides, _REACH * stretch


@kernel
def _reaches(
    boxes: np.ndarray,  # [B, 7] see `block_boxes`
    sides: np.ndarray,  # [5, 4] float64 planes: four sides of the image, then the plane of the camera
    wider: float,  # pixels per metre of sigma by which a box may be outside the sides of the image
) -> np.ndarray:  # [B] bool
    """Return whether each box has, for every plane, a point on the inner side.

    For the four sides of the image, a box is enlarged by ``wider`` times its largest sigma.
    """
    reaches = np.ones(len(boxes), np.bool_)
    for block in range(len(boxes)):
        for side in range(len(sides)):
            largest = sides[side, 3]
            for k in range(3):
                # The maximum over a box is at the corner in the direction of the normal.
                normal = sides[side, k]
                largest += normal * (boxes[block, 3 + k] if normal > 0.0 else boxes[block, k])
            if side < 4:
                largest += wider * boxes[block, 6]
            if largest < 0.0:
                reaches[block] = False
                break
    return reaches
