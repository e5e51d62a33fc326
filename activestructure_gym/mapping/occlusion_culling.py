"""Find blocks of the map that are occluded by the measured surface of a keyframe.

Gaussians behind a wall are inside the view frustum of many keyframes without being visible. A block is occluded if
every pixel that it can affect has a depth return more than `MARGIN` in front of the block's nearest point. Pixels
without a return occlude nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry import PinholeCamera, invert_rigid

MARGIN = 0.5  # metres behind the measured surface, more than depth noise and map error (own choice)
_TILE = 8  # pixels per side of a tile
_REACH = 3.35  # radius of a Gaussian in sigmas (the rasteriser stops at 3.34)
_BORDER = 2.0  # pixels by which the rasteriser's blur enlarges a Gaussian
_MIN_DEPTH_M = 0.05  # metres; a box that reaches a smaller depth is never occluded


class DepthTiles(NamedTuple):
    """Hold the largest depth in each tile of 8 x 8 pixels of a depth image, and its camera, as one kernel argument."""

    farthest: np.ndarray  # [h, w] float32 metres; inf if a pixel of the tile has no return
    camera_from_world: np.ndarray  # [3, 4] float64
    intrinsics: np.ndarray  # [4] float64 pixels: fx, fy, cx, cy
    size: tuple[int, int]  # width, height in pixels


def depth_tiles(
    depth: np.ndarray,  # [H, W] float32 metres; 0 = no return
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [4, 4]
) -> DepthTiles:
    """Return the largest depth of every tile of a depth image, together with its camera."""
    height, width = depth.shape
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    pose = np.ascontiguousarray(invert_rigid(world_from_camera)[:3])
    return DepthTiles(_farthest(np.ascontiguousarray(depth, np.float32)), pose, intrinsics, (width, height))


@kernel
def _farthest(depth: np.ndarray) -> np.ndarray:  # [H, W] float32 metres -> [h, w]
    """Return the largest depth of every tile of 8 x 8 pixels; inf if a pixel of the tile has no return."""
    height, width = depth.shape
    farthest = np.zeros((-(-height // _TILE), -(-width // _TILE)), np.float32)
    for v in range(height):
        for u in range(width):
            here = depth[v, u] if depth[v, u] > 0 else np.float32(np.inf)
            if here > farthest[v // _TILE, u // _TILE]:
                farthest[v // _TILE, u // _TILE] = here
    return farthest


@kernel
def behind_the_measured(
    boxes: np.ndarray,  # [B, 7] float64 metres, see `block_boxes`
    tiles: DepthTiles,
) -> np.ndarray:  # [B] bool
    """Return a mask of the boxes that are completely more than `MARGIN` behind the measured surface."""
    farthest, m, intrinsics, (width, height) = tiles
    hidden = np.zeros(len(boxes), np.bool_)
    for block in range(len(boxes)):
        wider = _REACH * boxes[block, 6]
        nearest = np.inf
        left, right, top, bottom = np.inf, -np.inf, np.inf, -np.inf
        for corner in range(8):
            x = boxes[block, 3] + wider if corner & 1 else boxes[block, 0] - wider
            y = boxes[block, 4] + wider if corner & 2 else boxes[block, 1] - wider
            z = boxes[block, 5] + wider if corner & 4 else boxes[block, 2] - wider
            depth = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
            nearest = min(nearest, depth)
            if not depth > _MIN_DEPTH_M:
                continue
            u = intrinsics[0] * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / depth + intrinsics[2]
            v = intrinsics[1] * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / depth + intrinsics[3]
            left, right = min(left, u), max(right, u)
            top, bottom = min(top, v), max(bottom, v)
        if not nearest > _MIN_DEPTH_M:
            continue
        first_column = int(max(0.0, min(left - _BORDER, width - 1.0))) // _TILE
        last_column = int(max(0.0, min(right + _BORDER, width - 1.0))) // _TILE
        first_row = int(max(0.0, min(top - _BORDER, height - 1.0))) // _TILE
        last_row = int(max(0.0, min(bottom + _BORDER, height - 1.0))) // _TILE
        covered = True
        for row in range(first_row, last_row + 1):
            for column in range(first_column, last_column + 1):
                if not farthest[row, column] + MARGIN < nearest:
                    covered = False
                    break
            if not covered:
                break
        hidden[block] = covered
    return hidden
