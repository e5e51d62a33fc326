"""Compute the depth of the surface that a map shows, which is sharper than the mean depth along a ray.

The weighted mean depth over the Gaussians of a ray is between two surfaces at every edge, and uses the depths of
centres. Here a pixel uses the single Gaussian at which the transmittance first falls to one half ([huang2024], median
depth). Its depth is that of the Gaussian's highest density along the ray ([yu2024], ray-Gaussian intersection). For an
oblique disk, this is the point where the ray meets the disk. A disk next to the camera can be drawn in pixels
whose rays meet its plane far beyond its end: then the depth is that of the centre.
"""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.rotations import matrix_rows
from activestructure_gym.splatting.layout import BLUR_VARIANCE
from activestructure_gym.splatting.passes import median_gaussian
from activestructure_gym.splatting.workspace import PooledWorkspace, fitted, inverse_of_pose

_PASSED = 3.0**2  # squared standard deviations: a ray that stays farther from the centre does not meet the Gaussian
_BEYOND_M = 1.0  # metres from the centre; small oblique disks are met a few pixels away from it, as on a floor far away


def surface_depth(
    parameters: np.ndarray,  # [14, capacity] float32
    count: int,  # number of Gaussians
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [C, 4, 4]
    *,
    blur_variance: float = float(BLUR_VARIANCE),  # px^2
    threads: int | None = None,
) -> np.ndarray:  # [C, H, W] float32 metres along the optical axis; 0 where the map is more than half transparent
    """Return the depth of the surface that the map shows in each of C cameras."""
    used, pooled = fitted(parameters), PooledWorkspace()
    depth = np.empty((len(world_from_camera), camera.height, camera.width), np.float32)
    intrinsics, whitening = np.array([camera.fx, camera.fy, camera.cx, camera.cy]), _whitening(used[:, :count])
    for picture, pose in zip(depth, np.asarray(world_from_camera, np.float64)):
        pooled.workspace.prepare(
            used, count, camera, inverse_of_pose(pose), blur_variance=blur_variance, threads=threads
        )
        _densest(used, whitening, median_gaussian(pooled.workspace, blended=False), pose, intrinsics, picture)
    return depth


def _whitening(parameters: np.ndarray) -> np.ndarray:  # [N, 3, 3]
    """Return matrices that convert an offset in metres to standard deviations along the axes of each Gaussian."""
    turn = parameters[3:7] / np.linalg.norm(parameters[3:7], axis=0)
    axes = np.array(matrix_rows(*turn))  # [world, axis, N]
    return np.ascontiguousarray((axes * np.exp(-parameters[7:10])).transpose(2, 1, 0))


@kernel
def _densest(
    parameters: np.ndarray,  # [14, capacity]
    whitening: np.ndarray,  # [N, 3, 3]
    gaussian: np.ndarray,  # [H, W] int64 column, -1 = none
    world_from_camera: np.ndarray,  # [4, 4]
    intrinsics: np.ndarray,  # [4] fx, fy, cx, cy in pixels
    depth: np.ndarray,  # [H, W] metres, output
) -> None:
    """Write the depth at which each pixel's ray is nearest to the centre of its Gaussian, in standard deviations.

    It is the depth of the centre if that point is more than 3 standard deviations and more than 1 m from the centre.
    """
    fx, fy, cx, cy = intrinsics
    m = world_from_camera
    for row in range(depth.shape[0]):
        for column in range(depth.shape[1]):
            i = gaussian[row, column]
            depth[row, column] = 0.0
            if i < 0:
                continue
            x, y = (column + 0.5 - cx) / fx, (row + 0.5 - cy) / fy
            along, square, offset, deep = 0.0, 0.0, 0.0, 0.0
            for axis in range(3):
                ray, centre = 0.0, 0.0
                for k in range(3):
                    ray += whitening[i, axis, k] * (m[k, 0] * x + m[k, 1] * y + m[k, 2])
                    centre += whitening[i, axis, k] * (parameters[k, i] - m[k, 3])
                along += ray * centre
                square += ray * ray
                offset += centre * centre
                deep += m[axis, 2] * (parameters[axis, i] - m[axis, 3])
            nearest = along / square
            far = abs(nearest - deep) * np.sqrt(x * x + y * y + 1.0) > _BEYOND_M
            if far and offset - along * nearest > _PASSED:
                nearest = deep
            # 0 if the point is behind the camera, which can be inside a large disk.
            depth[row, column] = max(nearest, 0.0)
