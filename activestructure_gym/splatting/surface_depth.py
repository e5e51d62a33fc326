"""Compute the depth of the surface shown by a map, sharper than the mean over a ray.

The mean depth over the Gaussians of a ray, by weight, is between two surfaces at every edge, and uses the depths of
the Gaussians' centres. Here a pixel uses the single Gaussian at which the transmittance first falls to one half
([huang2024], median depth). Its depth is that of the Gaussian's greatest density along the ray ([yu2024], ray-Gaussian
intersection). For an oblique disc, this is the point where the ray meets it.
"""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.rotations import matrix_rows
from activestructure_gym.splatting.layout import BLUR_VARIANCE
from activestructure_gym.splatting.passes import median_gaussian
from activestructure_gym.splatting.workspace import PooledWorkspace, fitted, inverse_of_pose


def surface_depth(
    parameters: np.ndarray,  # [14, capacity] float32
    count: int,
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [C, 4, 4]
    *,
    blur_variance: float = float(BLUR_VARIANCE),  # px^2
    threads: int | None = None,
) -> np.ndarray:  # [C, H, W] float32 metres along the optical axis, 0 where the map is more than half transparent
    """Return the depth of the map's surface for each camera."""
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
    """Return matrices that convert an offset in metres to standard deviations along a Gaussian's axes."""
    turn = parameters[3:7] / np.linalg.norm(parameters[3:7], axis=0)
    axes = np.array(matrix_rows(*turn))  # [world, axis, N]
    return np.ascontiguousarray((axes * np.exp(-parameters[7:10])).transpose(2, 1, 0))


@kernel
def _densest(
    parameters: np.ndarray,
    whitening: np.ndarray,  # [N, 3, 3]
    gaussian: np.ndarray,  # [H, W] int64 column, -1 = none
    world_from_camera: np.ndarray,
    intrinsics: np.ndarray,  # fx, fy, cx, cy
    depth: np.ndarray,  # [H, W] out
) -> None:
    """Write the depth where each pixel's ray is nearest to its Gaussian's centre, in standard deviations."""
    fx, fy, cx, cy = intrinsics
    m = world_from_camera
    for row in range(depth.shape[0]):
        for column in range(depth.shape[1]):
            i = gaussian[row, column]
            depth[row, column] = 0.0
            if i < 0:
                continue
            x, y = (column + 0.5 - cx) / fx, (row + 0.5 - cy) / fy
            along, square = 0.0, 0.0
            for axis in range(3):
                ray, centre = 0.0, 0.0
                for k in range(3):
                    ray += whitening[i, axis, k] * (m[k, 0] * x + m[k, 1] * y + m[k, 2])
                    centre += whitening[i, axis, k] * (parameters[k, i] - m[k, 3])
                along += ray * centre
                square += ray * ray
            depth[row, column] = max(along / square, 0.0)  # 0 behind a camera inside a large disc
