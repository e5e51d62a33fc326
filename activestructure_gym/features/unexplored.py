"""Compute the share of unexplored voxels visible from a view, the exploration score of ActiveGS."""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.geometry.camera import Lens
from activestructure_gym.volume import VoxelVolume

ANY_ALPHA = 0.003  # any Gaussian covers a pixel, as in ActiveGS; the smallest alpha that is rendered is 1 / 255
_SIDE = 2  # voxels per side of a tested cell: 0.2 m at the default voxel size, the voxel size of ActiveGS


@FEATURES.register("unexplored", unit="share of the voxels", low=0.0, high=1.0)
def unexplored(context: FeatureContext) -> np.ndarray:  # [K] in 0..1
    """Return the share of all voxels that are unexplored and visible from the view ([active_gs, code]).

    A voxel is visible if its centre projects into the image, within the integration range of the volume and in front of
    the rendered surface. Any Gaussian in a pixel is surface. A voxel is unexplored if `VoxelVolume.unobserved` is True.
    A cell of 2 x 2 x 2 unexplored voxels is tested once, at its centre.
    """
    return context.once(_shares)


def _shares(context: FeatureContext) -> np.ndarray:  # [K] in 0..1
    centres, unknown, total = unknown_cells(context.volume)
    seen = sums_in_front(centres, unknown, surface_within(context, ANY_ALPHA), context)
    return seen[:, 0] / total


def surface_within(context: FeatureContext, coverage_alpha: float) -> np.ndarray:  # [K, h, w] float32 metres of depth
    """Return the rendered depth of covered pixels and the integration range of other pixels; at most that range.

    A pixel is covered if its alpha exceeds ``coverage_alpha``.
    The integration range is the largest depth that the volume integrates, at most the sensor's range.
    """
    reach = np.float32(min(context.max_range, context.volume.config.max_range))
    with np.errstate(divide="ignore", invalid="ignore"):
        surface = np.where(context.alpha > coverage_alpha, context.depth / context.alpha, reach)
    return np.minimum(surface, reach)


def unknown_cells(volume: VoxelVolume) -> tuple[np.ndarray, np.ndarray, int]:  # [M, 3] metres, [M] voxels, all voxels
    """Return the unobserved space as M cells or single voxels: centres, voxels per cell, and the number of all voxels.

    A cell of 2 x 2 x 2 voxels is used where all eight are unobserved, and single voxels elsewhere. In a partly observed
    cell at a wall, the centre could be in front of the wall, and the unobserved part behind it. The outermost layer of
    the volume is outside the workspace and not counted.
    """
    inner = volume.unobserved[1:-1, 1:-1, 1:-1]
    x, y, z = (size // _SIDE for size in inner.shape)
    even = inner[: x * _SIDE, : y * _SIDE, : z * _SIDE]
    whole = even.reshape(x, _SIDE, y, _SIDE, z, _SIDE).all(axis=(1, 3, 5))
    single = inner.copy()
    single[: x * _SIDE, : y * _SIDE, : z * _SIDE] &= ~whole.repeat(_SIDE, 0).repeat(_SIDE, 1).repeat(_SIDE, 2)
    cells, voxels = np.argwhere(whole), np.argwhere(single)
    middles = np.concatenate([(cells + 0.5) * _SIDE, voxels + 0.5]) + 1.0
    counts = np.repeat([float(_SIDE**3), 1.0], [len(cells), len(voxels)])
    return volume.origin + middles * volume.config.voxel_size, counts, inner.size


def sums_in_front(
    points: np.ndarray,  # [M, 3] metres, world
    weights: np.ndarray,  # [M]
    surface: np.ndarray,  # [K, h, w] float32 metres of depth
    context: FeatureContext,
    group: np.ndarray | None = None,  # [M] group index of each point; None: one group
) -> np.ndarray:  # [K, groups]
    """Return, per candidate and group, the sum of ``weights`` of the points that the candidate sees.

    A point is visible if it projects into the image and its depth is less than ``surface`` at its pixel.
    """
    groups = np.zeros(len(points), np.int64) if group is None else group
    number = 1 if group is None else int(groups.max(initial=-1)) + 1
    poses = np.ascontiguousarray(context.world_from_camera, dtype=np.float64)
    return _sums(points, weights.astype(np.float64), groups, number, poses, context.camera.lens, surface)


@kernel
def _sums(
    points: np.ndarray,  # [M, 3] metres, world
    weights: np.ndarray,  # [M]
    groups: np.ndarray,  # [M] int64
    number: int,  # number of groups
    poses: np.ndarray,  # [K, 4, 4] world_from_camera
    lens: Lens,  # fx, fy, cx, cy in pixels
    surface: np.ndarray,  # [K, h, w] float32 metres of depth
) -> np.ndarray:  # [K, number]
    count, height, width = surface.shape
    result = np.zeros((count, number))
    for k in range(count):
        pose = poses[k]
        for m in range(len(points)):
            x, y, z = points[m, 0] - pose[0, 3], points[m, 1] - pose[1, 3], points[m, 2] - pose[2, 3]
            deep = pose[0, 2] * x + pose[1, 2] * y + pose[2, 2] * z
            if not deep > 0.0:
                continue
            u = lens[0] * (pose[0, 0] * x + pose[1, 0] * y + pose[2, 0] * z) / deep + lens[2]
            v = lens[1] * (pose[0, 1] * x + pose[1, 1] * y + pose[2, 1] * z) / deep + lens[3]
            if 0.0 <= u < width and 0.0 <= v < height and deep < surface[k, int(v), int(u)]:
                result[k, groups[m]] += weights[m]
    return result
