"""Compute GS-Planner's two gains: unobserved volume that the map lets through, and rendering loss of known surface."""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.features.context import FeatureContext, grid_rays
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.voxel_errors import LOSS_KEYFRAMES, spread
from activestructure_gym.sensors import Frame

STRIDE = 2  # pixels from one ray to the next
COLOUR_WEIGHT = 1.0  # lambda_C: metres of depth error per unit of colour error (0..1)


@FEATURES.register(
    "gs_planner",
    columns=("volume", "loss"),
    unit=("share of the frustum", "weighted error in m"),
    low=0.0,
    high=(1.0, np.inf),
)
def gs_planner(context: FeatureContext) -> np.ndarray:  # [K, 2]
    """Compute the transmitted unobserved volume (share of the frustum), and the mean rendering loss (m).

    The volume is the sum over pixels and over the unobserved intervals i on their rays of V_i T_i ([gs_planner]).
    V_i = (d_out - d_in) (S_in + sqrt(S_in S_out) + S_out) / 3 with S = d^2 / f^2 is the volume of the pixel's frustum
    in the interval. T_i is the map's transmittance before it. The unit is the volume of the whole frustum up to the
    depth range of the volume. T is 1 up to the rendered depth and 1 - alpha behind it; the original multiplies from
    splat to splat.

    The loss is the mean over pixels of L = L1(D) + lambda_C L1(C) of the first occupied voxel on the ray. L1(D) is the
    absolute depth error in metres, and L1(C) the absolute colour error in 0..1. L is measured by rendering keyframes
    with the current map. The original stores it in the voxels when an image arrives.
    """
    volume = context.volume
    alpha = context.alpha[:, ::STRIDE, ::STRIDE]
    shown = context.depth[:, ::STRIDE, ::STRIDE] / np.maximum(alpha, 1e-6)
    farthest = min(context.max_range, volume.config.max_range)
    volumes, losses = _walk(
        (volume.unobserved, volume.occupied, voxel_losses(context)),
        *grid_rays(volume, context.camera, context.world_from_camera, STRIDE),
        float(farthest),
        np.ascontiguousarray(shown, dtype=np.float32),
        np.ascontiguousarray(alpha, dtype=np.float32),
    )
    rays = alpha.shape[1] * alpha.shape[2]
    return np.column_stack([volumes / (rays * farthest**3), losses / rays])


def voxel_losses(context: FeatureContext) -> np.ndarray:  # [X, Y, Z] float32 metres
    """Return the mean loss L (see `gs_planner`) of the pixels whose measured surface point is in each voxel.

    The pixels are those of 16 keyframes. Voxels without pixels have 0.
    """
    mapper, volume = context.mapper, context.volume
    points, losses = [np.zeros((0, 3))], [np.zeros(0)]
    for index in spread(len(mapper.keyframes), LOSS_KEYFRAMES):
        frame = mapper.keyframes[index]
        rendered = mapper.render(frame.camera, frame.world_from_camera)
        depth = rendered.depth / np.maximum(rendered.alpha, 1e-6)
        found, loss = pixel_losses(frame, rendered.color, depth)
        points.append(found)
        losses.append(loss)
    at, loss = np.concatenate(points), np.concatenate(losses)
    inside = volume.contains(at)
    flat = np.ravel_multi_index(tuple(volume.voxel_of(at[inside]).T), volume.state.shape)
    voxels, which, count = np.unique(flat, return_inverse=True, return_counts=True)
    table = np.zeros(volume.state.size, dtype=np.float32)
    table[voxels] = np.bincount(which, weights=loss[inside], minlength=len(voxels)) / count
    return table.reshape(volume.state.shape)


def pixel_losses(
    frame: Frame,
    color: np.ndarray,  # [H, W, 3] rendered, 0..1
    depth: np.ndarray,  # [H, W] metres, rendered, of the surface: the accumulated depth over alpha
) -> tuple[np.ndarray, np.ndarray]:  # [N, 3] metres, world; [N] metres
    """Return the surface points and the losses L (see `gs_planner`) of all N pixels with measured depth."""
    measured = frame.depth > 0
    loss = np.abs(depth - frame.depth) + COLOUR_WEIGHT * np.abs(color - frame.rgb / 255.0).mean(axis=-1)
    points = frame.camera.backproject(frame.depth)[measured].astype(np.float64)
    pose = frame.world_from_camera
    return points @ pose[:3, :3].T + pose[:3, 3], loss[measured]


@kernel
def _walk(
    fields: tuple[np.ndarray, np.ndarray, np.ndarray],  # [X, Y, Z] bool unobserved, bool occupied, float32 losses
    origin: np.ndarray,  # [3] corner of voxel (0, 0, 0)
    voxel_size: float,  # metres
    poses: np.ndarray,  # [K, 4, 4] world_from_camera
    rays: np.ndarray,  # [h, w, 3] camera frame, depth 1
    farthest: float,  # metres of depth
    shown: np.ndarray,  # [K, h, w] metres: rendered depth of the map
    alpha: np.ndarray,  # [K, h, w] 0..1
) -> tuple[np.ndarray, np.ndarray]:  # [K] sum of T (d_out^3 - d_in^3), [K] sum of the losses met
    """Return, per candidate, the transmitted unobserved volume and the sum of the losses of the first surface voxels.

    Rays have steps of half a voxel. Three times the volume of a pixel's frustum between two depths is the difference of
    their cubes, times 1 / f^2. The factor 1 / (3 f^2) is left out.
    """
    unobserved, occupied, losses = fields
    size = unobserved.shape
    volumes = np.zeros(len(poses))
    met = np.zeros(len(poses))
    for k in range(len(poses)):
        pose = poses[k]
        start = (pose[:3, 3] - origin) / voxel_size
        for row in range(rays.shape[0]):
            for column in range(rays.shape[1]):
                ray = rays[row, column]
                step = 0.5 * voxel_size / np.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)  # metres of depth
                dx = (pose[0, 0] * ray[0] + pose[0, 1] * ray[1] + pose[0, 2] * ray[2]) / voxel_size
                dy = (pose[1, 0] * ray[0] + pose[1, 1] * ray[1] + pose[1, 2] * ray[2]) / voxel_size
                dz = (pose[2, 0] * ray[0] + pose[2, 1] * ray[1] + pose[2, 2] * ray[2]) / voxel_size
                behind = 1.0 - alpha[k, row, column]
                surface = shown[k, row, column] if behind < 1.0 else farthest
                hit = False
                near = 0.0
                while near < farthest:
                    far = min(near + step, farthest)
                    middle = 0.5 * (near + far)
                    i = int(np.floor(start[0] + middle * dx))
                    j = int(np.floor(start[1] + middle * dy))
                    m = int(np.floor(start[2] + middle * dz))
                    if i < 0 or j < 0 or m < 0 or i >= size[0] or j >= size[1] or m >= size[2]:
                        break
                    passing = 1.0 if middle < surface else behind
                    if passing < 0.01 and hit:
                        break
                    if unobserved[i, j, m]:
                        volumes[k] += passing * (far**3 - near**3)
                    elif occupied[i, j, m] and not hit:
                        met[k] += losses[i, j, m]
                        hit = True
                    near = far
    return volumes, met
