"""Compute COVER's gain: how much the directions of a view differ from the directions of the keyframes."""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.features.blending import blended
from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.view_directions import DIRECTIONS, view_directions
from activestructure_gym.geometry import fibonacci_directions
from activestructure_gym.mapping.boxes import BLOCK, block_boxes
from activestructure_gym.mapping.frustum_culling import may_be_seen


@FEATURES.register("view_angle", unit="mean of 1 - coverage", low=0.0, high=1.0)
def view_angle(context: FeatureContext) -> np.ndarray:  # [K] in 0..1
    """Compute 1 - the mean over mapped pixels of the coverage of the view direction (COVER, Chen et al. 2026).

    The coverage of a Gaussian in a direction is (cos theta + 1) / 2. theta is the angle to the nearest of 128 bins of
    directions from which a keyframe saw the Gaussian. Coverage is blended like a colour over 0. Pixels without any
    Gaussian are left out; the result is 0 for a view without others. Source: [cover, code].
    """
    gaussians, camera, bins = context.mapper.map, context.camera, view_directions(context.mapper).bins
    boxes = block_boxes(gaussians.parameters, gaussians.count)
    directions = fibonacci_directions(DIRECTIONS)

    def repaint(row: np.ndarray, pose: np.ndarray) -> None:
        seen = may_be_seen(boxes, camera, pose)
        cover(gaussians.parameters, gaussians.count, seen, pose[:3, 3].astype(np.float64), bins, directions, row)

    coverage = blended(context, np.zeros(gaussians.count, np.float32), repaint=repaint).sum(axis=(1, 2))
    mapped = (context.alpha > 0.0).sum(axis=(1, 2))
    return np.where(mapped > 0, 1.0 - coverage / np.maximum(mapped, 1), 0.0)


@kernel
def cover(
    parameters: np.ndarray,  # [14, capacity] float32
    count: int,  # number of Gaussians
    seen: np.ndarray,  # [blocks] bool; Gaussians of other blocks keep their value
    eye: np.ndarray,  # [3] metres, world: camera position
    bins: np.ndarray,  # [N, 2] uint64, see `ViewDirections.bins`
    directions: np.ndarray,  # [128, 3] unit
    coverage: np.ndarray,  # [N] float32, written
) -> None:
    """Write the coverage of each Gaussian for the direction to the eye; 0 if no keyframe saw it.

    It is (c + 1) / 2, where c is the largest cosine between this direction and the bins from which keyframes saw it.
    """
    for block in range(len(seen)):
        if not seen[block]:
            continue
        for i in range(block * BLOCK, min(count, (block + 1) * BLOCK)):
            x, y, z = eye[0] - parameters[0, i], eye[1] - parameters[1, i], eye[2] - parameters[2, i]
            length = np.sqrt(x * x + y * y + z * z)
            best = -1.0
            for word in range(2):
                left, at = bins[i, word], 64 * word
                while left:
                    if left & np.uint64(1):
                        cosine = (x * directions[at, 0] + y * directions[at, 1] + z * directions[at, 2]) / length
                        best = max(best, cosine)
                    left >>= np.uint64(1)
                    at += 1
            coverage[i] = 0.5 * (best + 1.0)
