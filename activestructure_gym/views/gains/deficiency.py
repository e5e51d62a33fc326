"""How much of a view would show what planes are known to lack (IG_def of Eq. 13)."""

from __future__ import annotations

import numpy as np

from activestructure_gym.views.gains.base import GAINS, GainContext
from activestructure_gym.views.visibility import cosines_in_sight


@GAINS.register("deficiency")
def deficiency(context: GainContext) -> np.ndarray:  # [K] in 0..1
    """Share of the image that deficiency centres C_def inside the frustum take up, occlusion included.

    A centre stands for a patch of area a; seen at distance z and under the angle theta it covers f_x f_y a cos / z^2
    pixels. So the term counts in the same unit as the pixel gain, and goes to 0 with the last hole. A patch that the
    map covers too coarsely counts only from where its Gaussians would be replaced by finer ones.
    """
    holes, camera, poses = context.planes.deficiencies, context.camera, context.world_from_camera
    if not len(holes) or not len(poses):
        return np.zeros(len(poses))
    cosines, _ = cosines_in_sight(
        holes.centres[:, None], holes.normals, camera, poses, context.volume,
        farthest=refining_distance(context, holes.sizes),
    )  # fmt: skip
    view, hole = np.nonzero(cosines[:, :, 0])
    depth = ((holes.centres[hole] - poses[view, :3, 3]) * poses[view, :3, 2]).sum(axis=1)
    pixels = camera.fx * camera.fy * holes.areas[hole] * cosines[view, hole, 0] / depth**2
    return np.minimum(np.bincount(view, pixels, minlength=len(poses)) / (camera.width * camera.height), 1.0)


def refining_distance(context: GainContext, sizes: np.ndarray) -> np.ndarray:  # [D] metres
    """From how far away a frame replaces Gaussians of these sizes by finer ones (`MapperConfig.coarse_ratio`)."""
    config, sensor = context.mapper.config, context.mapper.keyframes[-1].camera
    if config.coarse_ratio is None:
        return np.where(np.isinf(sizes), np.inf, 0.0)
    limit = config.coarse_ratio * config.seed_footprint * config.seed_stride  # pixels
    return sizes * 0.5 * (sensor.fx + sensor.fy) / limit
