"""Render images of any number per Gaussian, from every candidate."""

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
    """Return the sum of weight times value along the ray of each pixel, blended as colours are.

    Divide it by alpha for the weighted mean. The values replace the red channel in a copy of the map. For values that
    depend on the view, ``repaint(row, pose)`` writes them into ``row`` [N] before the image of each candidate ``pose``
    [4, 4] is rendered.
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
