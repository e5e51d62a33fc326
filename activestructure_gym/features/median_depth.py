"""Render the median depth of the map."""

from __future__ import annotations

import numpy as np

from activestructure_gym.geometry import PinholeCamera, invert_rigid
from activestructure_gym.mapping.frustum_culling import MapParts
from activestructure_gym.mapping.gaussian_map import GaussianMap
from activestructure_gym.splatting import passes
from activestructure_gym.splatting.workspace import PooledWorkspace, fitted


def median_depths(
    gaussians: GaussianMap,
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [C, 4, 4] poses
) -> np.ndarray:  # [C, H, W] float32 metres, 0 where alpha stays below one half
    """Return the median depth of every pixel: the depth of the Gaussian at which the transmittance falls to 0.5."""
    parameters, count = MapParts(gaussians).in_view(camera, world_from_camera)
    parameters = fitted(parameters)
    result = np.zeros((len(world_from_camera), camera.height, camera.width), np.float32)
    pooled = PooledWorkspace()
    for image, pose in zip(result, invert_rigid(world_from_camera)):
        pooled.workspace.render(parameters, count, camera, pose, keep=False)  # sorts the Gaussians for the next line
        image[:] = passes.median_depth(pooled.workspace)
    return result
