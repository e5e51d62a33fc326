"""GauSS-MI: mutual information between a view and the reliability of what it shows ([gauss_mi])."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.information import register_both
from activestructure_gym.geometry import rotation_angle
from activestructure_gym.mapping.frustum_culling import MapParts
from activestructure_gym.mapping.gaussian_map import COLOR
from activestructure_gym.policies.gauss_mi.reliability import DirectionalReliability

# A view this near to one of the last so many views that were chosen gains less, the less the more recent that one is.
NEAR_M, NEAR_DEG, REMEMBERED, FEW, FORGETTING = 0.3, 10.0, 100, 5, 0.95


@register_both("gauss_mi", unit="nats, mean over pixels")
def gauss_mi(context: FeatureContext) -> np.ndarray:  # [K]
    """Mean over pixels of sum_i w_i sum_dir c_dir (-log r_dir), then the discount of revisits.

    w_i is the weight of Gaussian i in the pixel, c_dir how much of the direction from the camera to it lies along each
    of +x, +y, -x, -y, and r_dir how reliable it is there (`reliability`). What is blended is one number per
    Gaussian, so a view costs one rendering: it takes the place of a colour.
    """
    gaussians, camera, render = context.mapper.map, context.camera, context.mapper.rasterizer.render
    # -log r: [4, N]. Single precision, row by row: this is done for every Gaussian and candidate.
    surprise = np.ascontiguousarray(np.logaddexp(0.0, -reliability(context)).T, dtype=np.float32)
    parts = MapParts(gaussians)
    rows = gaussians.parameters.copy()
    rows[COLOR] = 0.0
    gains = np.zeros(len(context.world_from_camera))
    for k, pose in enumerate(context.world_from_camera):
        rows[COLOR.start, : gaussians.count] = seen_from(pose[:3, 3], rows[:3, : gaussians.count], surprise)
        picture = render(rows, gaussians.count, camera, pose, unseen=parts.unseen(camera, pose)).color
        gains[k] = picture[..., 0].mean(dtype=np.float64)
    chosen = np.zeros((0, 4, 4)) if context.agent is None else context.agent.stops
    return gains * revisit_discount(context.world_from_camera, chosen)


def reliability(context: FeatureContext) -> np.ndarray:  # [N, 4] float64 log-odds, to be read only
    """Log-odds of every Gaussian's reliability from four sides; keyframes vote at the first call after them."""
    return context.episode(_reliability).update(context.mapper.keyframes)


def _reliability(context: FeatureContext) -> DirectionalReliability:
    return DirectionalReliability(context.mapper.persistent_map, context.mapper.config.backend)


def seen_from(
    eye: np.ndarray,  # [3] metres, world
    means: np.ndarray,  # [3, N] float32 metres, world
    surprise: np.ndarray,  # [4, N] float32, for +x, +y, -x, -y
) -> np.ndarray:  # [N] float32
    """Sum over the directions of `direction_shares` times surprise."""
    dx, dy, dz = means - eye.astype(np.float32)[:, None]
    along_x = np.where(dx > 0, surprise[0], surprise[2])
    along_y = np.where(dy > 0, surprise[1], surprise[3])
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    return (np.abs(dx) * along_x + np.abs(dy) * along_y) / np.maximum(length, np.float32(1e-9))


def revisit_discount(
    world_from_camera: np.ndarray,  # [K, 4, 4]
    chosen: np.ndarray,  # [T, 4, 4] views that were chosen, the newest one last
) -> np.ndarray:  # [K] in 0..1
    """1 - .95^k of the k-th view chosen before the newest one (k = 1, 2, ...) that a view repeats.

    1 without one, and while few were chosen. The newest one does not count.
    """
    discount = np.ones(len(world_from_camera))
    if len(chosen) <= FEW:
        return discount
    for k, pose in enumerate(chosen[-2::-1][:REMEMBERED], start=1):
        distance = np.linalg.norm(world_from_camera[:, :3, 3] - pose[:3, 3], axis=1)
        near = (distance < NEAR_M) & (np.degrees(rotation_angle(world_from_camera, pose)) < NEAR_DEG)
        discount[near] = np.minimum(discount[near], 1.0 - FORGETTING**k)
    return discount
