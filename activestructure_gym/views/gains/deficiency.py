"""How much of the known holes in planes a view would look into (IG_def of Eq. 13)."""

from __future__ import annotations

import numpy as np

from activestructure_gym.views.gains.base import GAINS, GainContext
from activestructure_gym.views.visibility import cosines_in_view


@GAINS.register("deficiency")
def deficiency(context: GainContext) -> np.ndarray:  # [K] in 0..1
    """Share of the deficiency centres C_def inside the frustum, in range and unoccluded, weighted by cos of incidence.

    A centre counts with the area of the hole it stands for (Sec. 3.3). Without any known hole the gain is 0.
    """
    holes = context.planes.deficiencies
    poses = context.world_from_camera
    if not len(holes) or not len(poses):
        return np.zeros(len(poses))
    cosines = cosines_in_view(holes.centres[:, None], holes.normals, context.camera, poses)[:, :, 0]  # [K, D]
    view, hole = np.nonzero(cosines)
    free = context.volume.sight_free(poses[view, :3, 3], holes.centres[hole])
    cosines[view[~free], hole[~free]] = 0.0
    return cosines @ holes.areas / holes.areas.sum()
