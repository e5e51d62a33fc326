"""Images of any per-Gaussian number, rendered from every candidate."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.mapping.frustum_culling import MapParts
from activestructure_gym.mapping.gaussian_map import COLOR


def blended(
    context: FeatureContext,
    values: np.ndarray | None = None,  # [N] float32, one per Gaussian
    *,
    repaint: Callable[[np.ndarray, np.ndarray], None] | None = None,
) -> np.ndarray:  # [K, h, w] float32
    """Sum of weight times value along every pixel's ray, as colours are blended: divide by alpha for the mean.

    The numbers take the place of the red colour in a copy of the map. ``repaint(row, pose)`` changes them in place
    [N] before the picture of each candidate ``pose`` [4, 4] is drawn, for numbers that depend on the view.
    """
    gaussians, camera, poses = context.mapper.map, context.camera, context.world_from_camera
    render = context.mapper.rasterizer.render
    parameters = gaussians.parameters.copy()
    row = parameters[COLOR.start, : gaussians.count]
    if values is not None:
        row[:] = values
    parts = MapParts(gaussians)
    pictures = np.empty((len(poses), camera.height, camera.width), np.float32)
    for k, pose in enumerate(poses):
        if repaint is not None:
            repaint(row, pose)
        shown = render(parameters, gaussians.count, camera, pose, unseen=parts.unseen(camera, pose))
        pictures[k] = shown.color[..., 0]
    return pictures
