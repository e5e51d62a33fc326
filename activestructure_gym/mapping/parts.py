"""The part of a large map that a camera can see, so that rendering costs what is in view and not the whole map.

Gaussians stand in the map in the order in which they were seeded, so a thousand neighbours in the arrays mostly lie
near each other. Each such block has a box; blocks whose box cannot reach the image are left out, and the others are
copied together. The bound is that of the rasteriser, so the pictures are the same to the last bit. Where a depth was
measured, what lies well behind it can be left out, too (`activestructure_gym.mapping.hidden`).
"""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry import PinholeCamera, invert_rigid
from activestructure_gym.mapping.gaussian_map import ROWS, GaussianMap
from activestructure_gym.mapping.hidden import behind_the_measured, depth_tiles
from activestructure_gym.splatting import layout
from activestructure_gym.splatting.workspace import aligned_zeros, make_view

BLOCK = 256  # Gaussians
_WORTHWHILE = 64  # blocks; a smaller map is rendered whole
_MOST = 0.5  # of the blocks; if more are in view, copying them costs more than it saves
_LANES = 16  # of which the capacity of a map is a multiple
_REACH = 3.35  # sigma (the rasteriser stops at 3.34)
_BLUR_PIXELS = 2.0  # by which its blur of .3 px^2 widens everything: 3.34 sqrt(.3) = 1.83


class MapParts:
    """Boxes around the blocks of a map as it is at construction; whatever changes the map makes them invalid.

    Unless the changes stay small: with ``shift`` and ``growth`` the boxes hold as long as no Gaussian moves further
    than ``shift`` metres or becomes larger than ``growth`` times its size.
    """

    def __init__(self, gaussians: GaussianMap, *, shift: float = 0.0, growth: float = 1.0) -> None:
        self._map = gaussians
        self._slack = np.array([-shift, -shift, -shift, shift, shift, shift]), growth
        large = gaussians.count > _WORTHWHILE * BLOCK and bool(np.isfinite([shift, growth]).all())
        self._boxes = self._made(0) if large else None

    def _made(self, first: int) -> np.ndarray:  # [B - first, 7]
        """Boxes of block ``first`` and those behind it."""
        boxes = block_boxes(self._map.parameters, self._map.count, first)
        boxes[:, :6] += self._slack[0]
        boxes[:, 6] *= self._slack[1]
        return boxes

    def extended(self, added: int) -> MapParts:
        """These boxes after ``added`` Gaussians were inserted behind the others."""
        if self._boxes is not None and added:
            first = (self._map.count - added) // BLOCK
            self._boxes = np.concatenate([self._boxes[:first], self._made(first)])
        return self

    def unseen(
        self,
        camera: PinholeCamera,
        world_from_camera: np.ndarray,  # [4, 4]
        depth: np.ndarray | None = None,  # [H, W] float32 metres, measured there; 0 = no return
    ) -> np.ndarray | None:  # [chunks] bool
        """The rasteriser's chunks without a block that the camera could see; None for a small map.

        With a measured ``depth`` also those that lie behind it (`hidden`), which a picture may show a trace of.
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
    ) -> tuple[np.ndarray, int]:  # parameters [14, capacity] float32, how many columns live
        """All Gaussians that can contribute to some picture of these cameras, in their order in the map.

        To be read only: where most of the map is in view, this is the map's own array.
        """
        rows = self._map.parameters
        if self._boxes is None:
            return rows, self._map.count
        seen = np.zeros(len(self._boxes), dtype=bool)
        for pose in np.asarray(world_from_camera, dtype=np.float64).reshape(-1, 4, 4):
            seen |= may_be_seen(self._boxes, camera, pose)
            if seen.mean() > _MOST:
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
    """False for blocks that lie behind the camera or whose every Gaussian ends outside one side of the image."""
    view = make_view(camera, np.eye(4))
    slope_x = max(abs(view[layout.LOW_X]), abs(view[layout.HIGH_X]))
    slope_y = max(abs(view[layout.LOW_Y]), abs(view[layout.HIGH_Y]))
    # An upper bound of the Jacobian's norm times the depth, at the slopes the rasteriser allows.
    stretch = np.sqrt(camera.fx**2 * (1.0 + slope_x**2) + camera.fy**2 * (1.0 + slope_y**2))
    border = _BLUR_PIXELS
    sides = np.array([
        [camera.fx, 0.0, camera.cx + border, 0.0],
        [-camera.fx, 0.0, camera.width + border - camera.cx, 0.0],
        [0.0, camera.fy, camera.cy + border, 0.0],
        [0.0, -camera.fy, camera.height + border - camera.cy, 0.0],
        [0.0, 0.0, 1.0, 0.0],
    ]) @ invert_rigid(world_from_camera)  # fmt: skip
    # The largest value over a box is at the corner that the side's normal points to.
    normal, offset = sides[:, :3], sides[:, 3]
    largest = boxes[:, 3:6] @ np.maximum(normal, 0.0).T + boxes[:, :3] @ np.minimum(normal, 0.0).T + offset
    largest[:, :4] += _REACH * stretch * boxes[:, 6:7]
    return ~(largest < 0.0).any(axis=1)


@kernel
def block_boxes(
    parameters: np.ndarray,  # [14, capacity] float32
    count: int,
    first_block: int,
) -> np.ndarray:  # [B, 7] float64 metres: least x, y, z, greatest x, y, z of the means, largest sigma
    """One box per block of `BLOCK` columns; means that are not a number are left out, for nobody sees them."""
    blocks = (count + BLOCK - 1) // BLOCK - first_block
    boxes = np.empty((blocks, 7))
    # One extreme per lane first: the compiler makes vectors of comparisons, but not of sums or extremes in sequence.
    least, greatest = np.empty(_LANES, np.float32), np.empty(_LANES, np.float32)
    for block in range(blocks):
        first, stop = (first_block + block) * BLOCK, min(count, (first_block + block + 1) * BLOCK)
        boxes[block, 6] = -np.inf
        for row in (0, 1, 2, 7, 8, 9):
            for lane in range(_LANES):
                least[lane], greatest[lane] = np.float32(np.inf), np.float32(-np.inf)
            # Whole vectors: what stands behind the last Gaussian may only make the last box larger.
            for i in range(first, stop, _LANES):
                for lane in range(_LANES):
                    value = parameters[row, i + lane]
                    least[lane] = value if value < least[lane] else least[lane]
                    greatest[lane] = value if value > greatest[lane] else greatest[lane]
            if row < 3:
                boxes[block, row], boxes[block, 3 + row] = least.min(), greatest.max()
            else:
                boxes[block, 6] = max(boxes[block, 6], greatest.max())
        boxes[block, 6] = np.exp(boxes[block, 6])
    return boxes
