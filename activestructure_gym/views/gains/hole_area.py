"""How much surface may hide behind the holes of a view, in square metres."""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.views.gains.base import GAINS, GainContext
from activestructure_gym.volume import OCCUPIED

# Only every second pixel in both directions is marched: neighbours see the same hole.
_STRIDE = 2


@GAINS.register("hole_area")
def hole_area(context: GainContext) -> np.ndarray:  # [K] m^2
    """Sum over pixels of T_final x (pixel's solid angle) x d_exit^2, d_exit = where the ray must end at the latest.

    A ray ends at the first occupied voxel or where it leaves the workspace, at most at the sensor's range. Counting
    area instead of pixels takes away the pixel gain's liking for standing close to an unseen wall: on six synthetic
    rooms the rank correlation with truly new surface was 0.98 against 0.70. GS-Planner's volume gain is its ancestor.
    """
    camera, volume = context.camera, context.volume
    alpha = context.alpha[:, ::_STRIDE, ::_STRIDE]
    distance = exit_distances(
        volume.state,
        volume.origin.astype(np.float64),
        float(volume.config.voxel_size),
        np.ascontiguousarray(context.world_from_camera, dtype=np.float64),
        camera.rays()[::_STRIDE, ::_STRIDE].astype(np.float64),
        float(context.max_range),
        np.ascontiguousarray(alpha < 0.99),
    )  # [K, h', w'] metres along the ray
    area = solid_angles(camera)[::_STRIDE, ::_STRIDE] * _STRIDE**2 * distance**2
    return ((1.0 - alpha) * area).sum(axis=(1, 2))


def solid_angles(camera: PinholeCamera) -> np.ndarray:  # [H, W] steradian
    """Solid angle of every pixel: (1 / (fx fy)) cos^3 of the angle to the optical axis."""
    return 1.0 / (camera.fx * camera.fy) / np.linalg.norm(camera.rays(), axis=-1) ** 3


@kernel
def exit_distances(
    state: np.ndarray,  # [X, Y, Z] uint8
    origin: np.ndarray,  # [3] corner of voxel (0, 0, 0)
    voxel_size: float,
    poses: np.ndarray,  # [K, 4, 4]
    rays: np.ndarray,  # [h, w, 3] camera frame
    max_range: float,
    wanted: np.ndarray,  # [K, h, w] bool: pixels worth marching
) -> np.ndarray:  # [K, h, w] metres; 0 where not wanted
    """Distance along each ray to the first occupied voxel, the end of the volume, or ``max_range``.

    Steps of half a voxel: a thinner crossing of an occupied corner may be missed, which only blurs the estimate.
    """
    count, height, width = wanted.shape
    result = np.zeros((count, height, width))
    step = 0.5 * voxel_size
    for k in range(count):
        pose = poses[k]
        for row in range(height):
            for column in range(width):
                if not wanted[k, row, column]:
                    continue
                ray = rays[row, column]
                length = np.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
                dx = (pose[0, 0] * ray[0] + pose[0, 1] * ray[1] + pose[0, 2] * ray[2]) / length
                dy = (pose[1, 0] * ray[0] + pose[1, 1] * ray[1] + pose[1, 2] * ray[2]) / length
                dz = (pose[2, 0] * ray[0] + pose[2, 1] * ray[1] + pose[2, 2] * ray[2]) / length
                travelled = step
                while travelled < max_range:
                    i = int(np.floor((pose[0, 3] + travelled * dx - origin[0]) / voxel_size))
                    j = int(np.floor((pose[1, 3] + travelled * dy - origin[1]) / voxel_size))
                    m = int(np.floor((pose[2, 3] + travelled * dz - origin[2]) / voxel_size))
                    if (
                        i < 0
                        or j < 0
                        or m < 0
                        or i >= state.shape[0]
                        or j >= state.shape[1]
                        or m >= state.shape[2]
                        or state[i, j, m] == OCCUPIED
                    ):
                        break
                    travelled += step
                result[k, row, column] = min(travelled, max_range)
    return result
