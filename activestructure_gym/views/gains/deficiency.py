"""How much of a view would show what planes are known to lack (IG_def of Eq. 13)."""

from __future__ import annotations

import numpy as np

from activestructure_gym.views.gains.base import GAINS, GainContext
from activestructure_gym.views.visibility import cosines_in_view


@GAINS.register("deficiency")
def deficiency(context: GainContext) -> np.ndarray:  # [K] in 0..1
    """Share of the image that deficiency centres C_def inside the frustum take up, occlusion included.

    A centre stands for a patch of area a; seen at distance z and under the angle theta it covers f_x f_y a cos / z^2
    pixels. So the term counts in the same unit as the pixel gain, and goes to 0 with the last hole. From further away
    than the map's seeds can fill a plane's cell, what a view adds falls with its sampling density.
    """
    holes, camera, poses = context.planes.deficiencies, context.camera, context.world_from_camera
    if not len(holes) or not len(poses):
        return np.zeros(len(poses))
    cosines = cosines_in_view(holes.centres[:, None], holes.normals, camera, poses)[:, :, 0]  # [K, D]
    view, hole = np.nonzero(cosines)
    free = context.volume.sight_free(poses[view, :3, 3], holes.centres[hole])
    view, hole = view[free], hole[free]
    offset = holes.centres[hole] - poses[view, :3, 3]
    depth = np.einsum("ij,ij->i", offset, poses[view, :3, 2])
    share = camera.fx * camera.fy * holes.areas[hole] * cosines[view, hole] / depth**2 / (camera.width * camera.height)
    density = np.minimum(1.0, (filling_distance(context) / depth) ** 2)
    return np.minimum(np.bincount(view, share * density, minlength=len(poses)), 1.0)


def filling_distance(context: GainContext) -> float:
    """Metres from which neighbouring seeds on a facing wall are one cell of a plane's grid apart."""
    sensor = context.mapper.keyframes[-1].camera
    return context.planes.config.cell * sensor.fx / context.mapper.config.seed_stride
