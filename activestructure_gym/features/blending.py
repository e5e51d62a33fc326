"""Render a given number per Gaussian into an image of every candidate view."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from activestructure_gym.features.context import FeatureContext


def blended(
    context: FeatureContext,
    values: np.ndarray,  # [N] float32, one per Gaussian
    *,
    repaint: Callable[[np.ndarray, np.ndarray], None] | None = None,
) -> np.ndarray:  # [K, h, w] float32
    """Return an image per candidate: the sum of weight x value over the Gaussians on the ray of each pixel.

    The weights are the blending weights of the colours. Divide the image by ``context.alpha`` for the weighted mean.
    For values that depend on the view, ``repaint(row, pose)`` is called before each candidate is rendered. It changes
    ``row`` [N], at first a copy of ``values``, for the camera ``pose`` [4, 4] (world_from_camera).
    """
    gaussians, poses = context.mapper.map, context.world_from_camera
    render = partial(context.mapper.rasterizer.render_values, gaussians.parameters, gaussians.count, context.camera)
    if repaint is None:
        return render(poses, values)
    row = values.copy()
    pictures = np.empty((len(poses), context.camera.height, context.camera.width), np.float32)
    for picture, pose in zip(pictures, poses):
        repaint(row, pose)
        picture[:] = render(pose, row)[0]
    return pictures
