"""Compute the largest area of unknown surface behind the transparent pixels of a view."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.features.context import FeatureContext, grid_rays
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.volume import FREE, OCCUPIED, VoxelVolume

# Pixels from one traced ray to the next, in both directions. Rays of neighbouring pixels cross the same holes.
_STRIDE = 2

# Metres, the distance beyond which a surface counts no more. Measured (docs/notebook/method.md) with a map that was too
# sparse on surfaces seen from farther away; the present map is dense there too (docs/notebook/map.md).
REACH = 4.0

# Metres and radians. Two poses that differ by less count as one view, since recorded poses have noise (own choice).
_SAME_PLACE, _SAME_DIRECTION = 0.05, np.radians(5.0)


@FEATURES.register("hole_area", unit="share of the largest possible", low=0.0, high=1.0)
def hole_area(context: FeatureContext) -> np.ndarray:  # [K] in 0..1
    """Return the sum over pixels of T_final x solid angle x min(d_exit, reach)^2, as a share of the largest such sum.

    T_final = 1 - alpha is the final transmittance of the pixel. d_exit is the largest possible distance of a surface
    along its ray: the distance to the first occupied voxel or to the border of the workspace, at most the sensor's
    range. reach is 4 m. An area is used instead of a number of pixels, so that a hole has the same value from near and
    from afar.

    A pixel counts 0 if its ray meets neither an unknown nor an occupied voxel. Voxels that a ray without return crossed
    (`VoxelVolume.no_return`) are left out; an occupied one of them ends the ray. An open window, a crack or a dark
    surface is always transparent. Once it has been observed, the view leaves the pool ("coupling pool dynamics to
    reconstruction state", Sec. 3.4). A view close to a keyframe pose counts 0: its surfaces are mapped, and its
    remaining holes have no depth return. The gain is derived from the unobserved volume of GS-Planner.
    """
    camera = context.camera
    alpha = context.alpha[:, ::_STRIDE, ::_STRIDE]
    distance = hidden_distances(
        context.volume, camera, context.world_from_camera, context.max_range, alpha < 0.99, stride=_STRIDE, enough=REACH
    )
    angle = solid_angles(camera)[::_STRIDE, ::_STRIDE] * _STRIDE**2
    area = (1.0 - alpha) * angle * np.minimum(distance, REACH) ** 2
    keyframes = np.array([frame.world_from_camera for frame in context.mapper.keyframes]).reshape(-1, 4, 4)
    new = np.logical_not(taken_before(context.world_from_camera, keyframes))
    return np.minimum(area.sum(axis=(1, 2)) / largest_area(camera), 1.0) * new


def taken_before(
    views: np.ndarray,  # [K, 4, 4] world_from_camera
    keyframes: np.ndarray,  # [T, 4, 4] world_from_camera
) -> np.ndarray:  # [K] bool
    """Return which views are within 5 cm and 5 degrees of a keyframe."""
    near = np.linalg.norm(views[:, None, :3, 3] - keyframes[None, :, :3, 3], axis=-1) < _SAME_PLACE
    along = np.einsum("ki,ti->kt", views[:, :3, 2], keyframes[:, :3, 2]) > np.cos(_SAME_DIRECTION)
    return np.asarray((near & along).any(axis=1))


@lru_cache(maxsize=4)
def solid_angles(camera: PinholeCamera) -> np.ndarray:  # [H, W] steradian, read-only
    """Return the solid angle of every pixel: cos^3(angle to the optical axis) / (fx fy)."""
    angles = 1.0 / (camera.fx * camera.fy) / np.linalg.norm(camera.rays(), axis=-1) ** 3
    angles.setflags(write=False)
    return np.asarray(angles)


def largest_area(camera: PinholeCamera) -> float:  # m^2
    """Return the largest possible sum of `hole_area`: that of a view in which all pixels are transparent up to 4 m."""
    return float(solid_angles(camera).sum()) * REACH**2


def hidden_distances(
    volume: VoxelVolume,
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [K, 4, 4]
    max_range: float,  # metres of depth
    wanted: np.ndarray,  # [K, h, w] bool: pixels to trace
    *,
    stride: int,  # pixels between neighbours in ``wanted``
    enough: float = np.inf,  # metres; a result above it is only a lower bound
) -> np.ndarray:  # [K, h, w] metres along the ray; 0 where not wanted, and without such a surface
    """Return the largest distance at which each pixel's ray can meet a surface that the map lacks.

    This is the distance to the first occupied voxel, or to the end of the ray if unknown voxels are on it.
    """
    return _march(
        _Space(volume.state, volume.no_return),
        *grid_rays(volume, camera, world_from_camera, stride),
        float(max_range),
        float(enough),
        np.ascontiguousarray(wanted),
    )


class _Space(NamedTuple):
    """Hold the voxels of the volume for the kernel `_march`."""

    state: np.ndarray  # [X, Y, Z] uint8
    no_return: np.ndarray  # [X, Y, Z] bool: a ray without return crossed the voxel


@kernel
def _march(
    space: _Space,
    origin: np.ndarray,  # [3] corner of voxel (0, 0, 0)
    voxel_size: float,  # metres
    poses: np.ndarray,  # [K, 4, 4] world_from_camera
    rays: np.ndarray,  # [h, w, 3] camera frame, depth 1
    max_range: float,  # metres of depth
    enough: float,  # metres; a ray ends there once its result is known to be larger
    wanted: np.ndarray,  # [K, h, w] bool: pixels to trace
) -> np.ndarray:  # [K, h, w] metres along the ray
    """Return the distance to the first occupied voxel, else to the end of the ray if it crosses unknown space, else 0.

    The ray ends at the border of the volume or at the range. Its steps are half a voxel. Unknown space means that two
    consecutive steps are unknown: a single one can be the corner of a voxel that no earlier ray crossed. An occupied
    corner shorter than a step can be missed, which makes the estimate slightly less precise.

    Voxels of ``no_return`` hide no surface: an unknown one counts as free, and an occupied one only ends the ray.
    """
    state, no_return = space
    count, height, width = wanted.shape
    result = np.zeros((count, height, width))
    for k in range(count):
        pose = poses[k]
        start = (pose[:3, 3] - origin) / voxel_size
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
                x, y, z = start[0], start[1], start[2]
                steps, unknown, meets = 0, 0, False
                for _ in range(int(max_range * length / (0.5 * voxel_size))):
                    x, y, z = x + dx, y + dy, z + dz
                    i, j, m = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
                    if i < 0 or j < 0 or m < 0 or i >= state.shape[0] or j >= state.shape[1] or m >= state.shape[2]:
                        break
                    steps += 1
                    here = state[i, j, m]
                    if here == OCCUPIED:
                        meets = meets or not no_return[i, j, m]
                        break
                    unknown = 0 if here == FREE or no_return[i, j, m] else unknown + 1
                    meets = meets or unknown == 2
                    if meets and 0.5 * voxel_size * steps >= enough:
                        break
                if meets:
                    result[k, row, column] = 0.5 * voxel_size * steps
    return result
