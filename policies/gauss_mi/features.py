"""Compute GauSS-MI: the mutual information between a view and the reliability of its Gaussians ([gauss_mi])."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.information import register_both
from activestructure_gym.geometry import rotation_angle
from activestructure_gym.mapping.frustum_culling import MapParts
from activestructure_gym.mapping.gaussian_map import COLOR
from activestructure_gym.policies.gauss_mi.reliability import DirectionalReliability

# The gain of a view within NEAR_M (metres) and NEAR_DEG (degrees) of one of the last REMEMBERED chosen views is
# reduced. The factor is 1 - FORGETTING^k for the k-th view before the newest. There is no reduction until more than FEW
# views were chosen. The code requires more than five poses; its first three are not chosen.
NEAR_M, NEAR_DEG, REMEMBERED, FEW, FORGETTING = 0.3, 10.0, 100, 2, 0.95


@register_both("gauss_mi", unit="nats, mean over pixels")
def gauss_mi(context: FeatureContext) -> np.ndarray:  # [K]
    """Compute the mean over pixels of sum_i w_i sum_dir c_dir (-log r_dir) in nats, discounted for revisits.

    w_i is the weight of Gaussian i in the pixel. c_dir are the components along +x, +y, -x, -y of the unit vector from
    the camera to the Gaussian. r_dir is the probability that the Gaussian is correct from that side (`reliability`).
    The inner sum is one number per Gaussian. It is rendered in place of a colour, so a candidate costs one rendering.
    """
    gaussians, camera, render = context.mapper.map, context.camera, context.mapper.rasterizer.render
    # -log r, [4, N]. Single precision is faster; the array is read for every Gaussian and candidate.
    surprise = np.ascontiguousarray(np.logaddexp(0.0, -reliability(context)).T, dtype=np.float32)
    parts = MapParts(gaussians)
    rows = gaussians.parameters.copy()
    rows[COLOR] = 0.0
    gains = np.zeros(len(context.world_from_camera))
    for k, pose in enumerate(context.world_from_camera):
        rows[COLOR.start, : gaussians.count] = seen_from(pose[:3, 3], rows[:3, : gaussians.count], surprise)
        image = render(rows, gaussians.count, camera, pose, unseen=parts.unseen(camera, pose)).color
        gains[k] = image[..., 0].mean(dtype=np.float64)
    chosen = np.zeros((0, 4, 4)) if context.agent is None else context.agent.stops
    return gains * revisit_discount(context.world_from_camera, chosen)


def reliability(context: FeatureContext) -> np.ndarray:  # [N, 4] float64 log-odds, to be read only
    """Return the log-odds that each Gaussian is correct from the sides +x, +y, -x, -y, updated by new keyframes."""
    return context.episode(_reliability).update(context.mapper.keyframes)


def _reliability(context: FeatureContext) -> DirectionalReliability:
    return DirectionalReliability(context.mapper.persistent_map, context.mapper.config.backend)


def seen_from(
    eye: np.ndarray,  # [3] metres, world
    means: np.ndarray,  # [3, N] float32 metres, world
    surprise: np.ndarray,  # [4, N] float32, for +x, +y, -x, -y
) -> np.ndarray:  # [N] float32
    """Return, for each Gaussian, the sum of `direction_shares` from ``eye`` times ``surprise`` over four directions.

    ``surprise`` is -log r of each direction in nats.
    """
    dx, dy, dz = means - eye.astype(np.float32)[:, None]
    along_x = np.where(dx > 0, surprise[0], surprise[2])
    along_y = np.where(dy > 0, surprise[1], surprise[3])
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    return (np.abs(dx) * along_x + np.abs(dy) * along_y) / np.maximum(length, np.float32(1e-9))


def revisit_discount(
    world_from_camera: np.ndarray,  # [K, 4, 4]
    chosen: np.ndarray,  # [T, 4, 4] chosen views, the newest one last
) -> np.ndarray:  # [K] in 0..1
    """Return a factor on the gain: 1 - 0.95^k for a view that repeats the k-th view chosen before the newest one.

    A view repeats another one within 0.3 m and 10 degrees. The factor is 1 for a view that repeats none of the last
    100, and until more than two views were chosen. The newest chosen view does not count.
    """
    discount = np.ones(len(world_from_camera))
    if len(chosen) <= FEW:
        return discount
    for k, pose in enumerate(chosen[-2::-1][:REMEMBERED], start=1):
        distance = np.linalg.norm(world_from_camera[:, :3, 3] - pose[:3, 3], axis=1)
        near = (distance < NEAR_M) & (np.degrees(rotation_angle(world_from_camera, pose)) < NEAR_DEG)
        discount[near] = np.minimum(discount[near], 1.0 - FORGETTING**k)
    return discount
