"""Uncovered pixels behind which something may still be."""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.views.gains.base import GAINS, GainContext
from activestructure_gym.volume import FREE, OCCUPIED, VoxelVolume

# Only every second pixel in both directions is marched: neighbours see the same hole.
_STRIDE = 2


@GAINS.register("unexplained")
def unexplained(context: GainContext) -> np.ndarray:  # [K] in 0..1
    """IG_px without the pixels that are known to show nothing, as a share of the image.

    A pixel without confident coverage counts only if its ray meets unknown space before it meets a surface, leaves the
    workspace or reaches the sensor's range. An open window, or a scan's missing ceiling, is uncovered for ever: once
    it was looked through, the volume knows it to be free, and the view leaves the pool ("coupling pool dynamics to
    reconstruction state", Sec. 3.4).
    """
    uncovered = context.alpha <= context.coverage_alpha
    meets = meets_unknown_space(
        context.volume, context.camera, context.world_from_camera, context.max_range, uncovered
    )
    return meets.mean(axis=(1, 2))


def meets_unknown_space(
    volume: VoxelVolume,
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [K, 4, 4]
    max_range: float,  # metres of depth
    wanted: np.ndarray,  # [K, H, W] bool
) -> np.ndarray:  # [K, H / 2, W / 2] bool
    """`meets_unknown` for every second pixel in both directions."""
    return meets_unknown(
        volume.state,
        volume.origin.astype(np.float64),
        float(volume.config.voxel_size),
        np.ascontiguousarray(world_from_camera, dtype=np.float64),
        camera.rays()[::_STRIDE, ::_STRIDE].astype(np.float64),
        float(max_range),
        np.ascontiguousarray(wanted[:, ::_STRIDE, ::_STRIDE]),
    )


@kernel
def meets_unknown(
    state: np.ndarray,  # [X, Y, Z] uint8
    origin: np.ndarray,  # [3] corner of voxel (0, 0, 0)
    voxel_size: float,
    poses: np.ndarray,  # [K, 4, 4] world_from_camera
    rays: np.ndarray,  # [h, w, 3] camera frame, depth 1
    max_range: float,  # metres of depth
    wanted: np.ndarray,  # [K, h, w] bool: pixels worth marching
) -> np.ndarray:  # [K, h, w] bool
    """Whether a wanted ray meets unknown space before it ends: two steps in a row, of half a voxel each.

    One step alone may be a corner that no ray of an earlier image went through.
    """
    count, height, width = wanted.shape
    result = np.zeros((count, height, width), np.bool_)
    for k in range(count):
        pose = poses[k]
        start_x = (pose[0, 3] - origin[0]) / voxel_size
        start_y = (pose[1, 3] - origin[1]) / voxel_size
        start_z = (pose[2, 3] - origin[2]) / voxel_size
        for row in range(height):
            for column in range(width):
                if not wanted[k, row, column]:
                    continue
                ray = rays[row, column]
                length = np.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
                scale = 0.5 / length
                dx = (pose[0, 0] * ray[0] + pose[0, 1] * ray[1] + pose[0, 2] * ray[2]) * scale
                dy = (pose[1, 0] * ray[0] + pose[1, 1] * ray[1] + pose[1, 2] * ray[2]) * scale
                dz = (pose[2, 0] * ray[0] + pose[2, 1] * ray[1] + pose[2, 2] * ray[2]) * scale
                x, y, z = start_x, start_y, start_z
                unknown = 0
                for _ in range(int(max_range * length / (0.5 * voxel_size))):
                    x, y, z = x + dx, y + dy, z + dz
                    i, j, m = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
                    if i < 0 or j < 0 or m < 0 or i >= state.shape[0] or j >= state.shape[1] or m >= state.shape[2]:
                        break
                    here = state[i, j, m]
                    if here == OCCUPIED:
                        break
                    unknown = 0 if here == FREE else unknown + 1
                    if unknown == 2:
                        result[k, row, column] = True
                        break
    return result
