"""Compute HGS-Planner's gain: unseen space that the map lets through, and Fisher information in known space.

Source: [hgs_planner], by its text.
"""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.features.context import FeatureContext, grid_rays
from activestructure_gym.features.fisherrf import fisherrf
from activestructure_gym.features.information import ADAPTIVE, adaptive, observed_share
from activestructure_gym.features.registry import FEATURES

RANGE = 5.0  # metres of depth, largest range of a ray (HGS-Planner's sensor)
_STRIDE = 2  # pixels from one ray to the next; rays of neighbouring pixels meet the same voxels


@FEATURES.register("hgs_planner", unit=ADAPTIVE, low=0.0)
def hgs_planner(context: FeatureContext) -> np.ndarray:  # [K]
    """Compute G = G_cov + lambda_o G_Q, where G_cov is `hgs_coverage` and G_Q is `fisherrf`.

    G_cov is divided by its maximum over the candidates, and G_Q is replaced by its rank in 0..1. lambda_o is the
    observed share of the voxels around the agent (`adaptive`).
    """
    return adaptive(context, context.once(hgs_coverage), context.once(fisherrf))


@FEATURES.register("hgs_planner_raw", unit="m^3 plus weighted information, per Gaussian", low=0.0)
def hgs_planner_raw(context: FeatureContext) -> np.ndarray:  # [K]
    """Compute G_cov + lambda_o G_Q as sums without a common unit, as in the paper's text, divided by N Gaussians.

    The division changes no choice; sums would exceed `envs.observation.MAX_FEATURE`. G_cov is the sum of volume times
    transmittance (m^3) over the unobserved voxels on the rays of all pixels of the scoring camera. G_Q is the sum of
    H_c / (H_train + lambda) over all parameters of all Gaussians (`fisherrf`).
    """
    on_ray = min(RANGE, context.max_range) * context.volume.config.voxel_size**2  # m^3 of the voxels on a ray
    volume = context.once(hgs_coverage) * on_ray * context.camera.width * context.camera.height
    return volume / max(1, context.mapper.map.count) + observed_share(context) * context.once(fisherrf)


@FEATURES.register("hgs_coverage", unit="share of the rays", low=0.0, high=1.0)
def hgs_coverage(context: FeatureContext) -> np.ndarray:  # [K] in 0..1
    """Compute G_cov, the transmitted length of rays in unobserved voxels as a share of the range (mean over pixels).

    A length is multiplied by the transmittance: 1 up to the rendered depth and 1 - alpha behind it. The result is
    proportional to the paper's sum of volume times transmittance, since all voxels have the same volume. It is 1 for a
    view of only unobserved space.
    """
    depth, alpha = context.depth[:, ::_STRIDE, ::_STRIDE], context.alpha[:, ::_STRIDE, ::_STRIDE]
    volume, reach = context.volume, min(RANGE, context.max_range)
    return _transmitted_unknown(
        volume.unobserved,
        *grid_rays(volume, context.camera, context.world_from_camera, _STRIDE),
        np.ascontiguousarray(depth / np.maximum(alpha, 1e-6)),
        np.ascontiguousarray(alpha),
        reach,
    )


@kernel
def _transmitted_unknown(
    unobserved: np.ndarray,  # [X, Y, Z] bool
    origin: np.ndarray,  # [3] corner of voxel (0, 0, 0)
    voxel_size: float,  # metres
    poses: np.ndarray,  # [K, 4, 4] world_from_camera
    rays: np.ndarray,  # [h, w, 3] camera frame, depth 1
    depth: np.ndarray,  # [K, h, w] metres, rendered
    alpha: np.ndarray,  # [K, h, w] opacity
    reach: float,  # metres of depth
) -> np.ndarray:  # [K]
    """Return the mean over pixels of the transmittance along the ray, counted in unobserved voxels only.

    It is 1 if all voxels are unobserved and the map is empty.
    """
    count, height, width = depth.shape
    size = unobserved.shape
    shares = np.zeros(count)
    for k in range(count):
        pose, total = poses[k], 0.0
        start = (pose[:3, 3] - origin) / voxel_size
        for row in range(height):
            for column in range(width):
                ray = rays[row, column]
                length = np.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
                scale = 0.5 / length
                dx = (pose[0, 0] * ray[0] + pose[0, 1] * ray[1] + pose[0, 2] * ray[2]) * scale
                dy = (pose[1, 0] * ray[0] + pose[1, 1] * ray[1] + pose[1, 2] * ray[2]) * scale
                dz = (pose[2, 0] * ray[0] + pose[2, 1] * ray[1] + pose[2, 2] * ray[2]) * scale
                steps = int(reach / (voxel_size * scale))
                wall = int(depth[k, row, column] / (voxel_size * scale))
                behind = 1.0 - alpha[k, row, column]
                x, y, z, seen = start[0], start[1], start[2], 0.0
                for step in range(steps if behind > 0.01 else min(steps, wall)):
                    x, y, z = x + dx, y + dy, z + dz
                    i, j, m = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
                    if i < 0 or j < 0 or m < 0 or i >= size[0] or j >= size[1] or m >= size[2]:
                        break
                    if unobserved[i, j, m]:
                        seen += 1.0 if step < wall else behind
                total += seen / max(1, steps)
        shares[k] = total / (height * width)
    return shares
