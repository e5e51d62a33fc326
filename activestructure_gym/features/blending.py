"""Render a given number per Gaussian into an image of every candidate view."""

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
    """Return an image per candidate: the sum of weight x value over the Gaussians on the ray of each pixel.

    The weights are the blending weights of the colours. Divide the image by ``context.alpha`` for the weighted mean.
    For values that depend on the view, ``repaint(row, pose)`` is called before each candidate is rendered. It writes
    the values for the camera ``pose`` [4, 4] (world_from_camera) into ``row`` [N].
    """
    gaussians, camera, poses = context.mapper.map, context.camera, context.world_from_camera
    render = context.mapper.rasterizer.render
    parameters = gaussians.parameters.copy()
    row = parameters[COLOR.start, : gaussians.count]  # the red channel, in a copy of the map
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
