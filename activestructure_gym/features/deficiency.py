"""IG_def of Eq. 13: area of known deficiencies of planes that a view would mend."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.hole_area import REACH, largest_area
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.views.visibility import cosines_in_sight


@FEATURES.register("deficiency", unit="as hole_area", low=0.0, high=1.0)
def deficiency(context: FeatureContext) -> np.ndarray:  # [K] in 0..1
    """Area of the deficiency centres C_def that a view would mend, in the unit of `hole_area`.

    A centre stands for a patch of known area. It counts where it is in sight and near enough for the surface there to
    become reconstructed: a hole up to the reach of `hole_area`, a patch that the map covers too coarsely from where its
    Gaussians would be replaced by finer ones. A hole in which some image showed something else, such as a window, does
    not count: no view will ever fill it.
    """
    holes, camera, poses = context.planes.deficiencies, context.camera, context.world_from_camera
    if not len(holes) or not len(poses):
        return np.zeros(len(poses))
    cosines, _ = cosines_in_sight(
        holes.centres[:, None], holes.normals, camera, poses, context.volume,
        farthest=np.minimum(refining_distance(context, holes.sizes), REACH),
    )  # fmt: skip
    area = (cosines[:, :, 0] > 0) @ np.where(holes.explained, 0.0, holes.areas)
    return area / largest_area(camera)


def refining_distance(context: FeatureContext, sizes: np.ndarray) -> np.ndarray:  # [D] metres
    """Largest distance at which a frame replaces Gaussians of these sizes (`MapperConfig.coarse_ratio`).

    Where there is texture; plain surface is as fine as it gets.
    """
    config, sensor = context.mapper.config, context.mapper.keyframes[-1].camera
    if config.coarse_ratio is None or config.seed_spacing is None:  # then nothing is ever replaced
        return np.where(np.isinf(sizes), np.inf, 0.0)
    limit = config.coarse_ratio * config.seed_footprint * config.seed_pixels  # pixels
    return sizes * 0.5 * (sensor.fx + sensor.fy) / limit
