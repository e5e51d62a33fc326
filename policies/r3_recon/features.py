"""Compute R3-RECON's utility: unexplored space, and surface with low renderability from a view's side ([r3_recon])."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.unexplored import unexplored, unknown_cells
from activestructure_gym.features.view_directions import is_hidden
from activestructure_gym.geometry import fibonacci_directions
from activestructure_gym.geometry.camera import Lens
from activestructure_gym.policies.r3_recon.surface_views import DIRECTIONS, SurfaceViews

EXPLORATION = 1000.0  # weight of an unexplored voxel; a surface voxel without renderability has weight 1
UNEXPLORED_VOXEL = 0.2  # metres, side of the unexplored voxels in the original
COLOUR_SCALE = 1.154  # 2 / sqrt(3): the renderability is 0 if half of the colours are black and half white
FINE = 0.01 / 5.0  # metres per pixel; nearer views than a keyframe with this resolution improve nothing


@FEATURES.register(
    "r3_recon",
    columns=("", "mean_loss"),
    unit=("weighted share of the voxels", "mean of 1 - R"),
    low=0.0,
    high=(np.inf, 1.0),
)
def r3_recon(context: FeatureContext) -> np.ndarray:  # [K, 2]
    """Compute U = #visible unexplored / #voxels + sum over visible surface voxels of (1 - R) / (1000 #voxels).

    The second column is the mean of 1 - R over these surface voxels, or 0 without any.

    R = h^(1 - a) a (1 - s)^(1 - a h) is the renderability of a voxel from a side ([r3_recon, code]):

    - a = max(0, cos) of the angle between the view and the nearest direction from which keyframes saw the voxel
      (64 bins);
    - h = 1 - 1.154 sqrt(trace of the covariance of the colours they saw), in 0..1, and 1 if all saw the same colour;
    - a and h are squared unless the other bins surround the nearest one (`surrounding`);
    - s = max(0, 1 - d / d_min), where d is the distance of the view and d_min that of the nearest keyframe; s is 0 if
      1 cm covered 5 pixels in a keyframe.

    A surface voxel of 5 cm is visible if its centre projects into the image and is not hidden by the rendered surface
    (`is_hidden`).
    Unexplored voxels are those of `unexplored`, in units of 0.2 m. The original does not divide by #voxels.
    """
    volume = context.volume
    voxels = unknown_cells(volume)[2] * (volume.config.voxel_size / UNEXPLORED_VOXEL) ** 3
    seen = context.episode(_surface_views).update(context.mapper.keyframes)
    certainty = 1.0 - COLOUR_SCALE * np.sqrt(seen.spread)
    frames = context.mapper.keyframes
    fine = FINE * frames[-1].camera.fx if frames else 0.0
    nearest = np.where(seen.nearest < fine, 0.0, seen.nearest)
    with np.errstate(divide="ignore", invalid="ignore"):
        surface = np.where(context.alpha > context.coverage_alpha, context.depth / context.alpha, np.float32(np.inf))
    lost, count = lost_renderability(
        (seen.centres, seen.directions, certainty, nearest),
        np.ascontiguousarray(context.world_from_camera, dtype=np.float64),
        context.camera.lens,
        surface,
        fibonacci_directions(DIRECTIONS),
        surrounding(),
    ).T
    return np.stack([unexplored(context) + lost / (EXPLORATION * voxels), lost / np.maximum(count, 1.0)], axis=1)


def _surface_views(context: FeatureContext) -> SurfaceViews:
    return SurfaceViews()


@lru_cache(1)
def surrounding() -> np.ndarray:  # [64, 4] uint64
    """Return the bins on the positive and the negative side of each bin q along u, and along v, as bits.

    u and v span the plane perpendicular to q; u is the part of the axis with the smallest component of q. Seen bins
    surround q if there is one on each of the four sides.
    """
    bins = fibonacci_directions(DIRECTIONS)
    u = np.eye(3)[np.abs(bins).argmin(axis=1)]
    u -= bins * (bins * u).sum(axis=1, keepdims=True)
    sides = np.empty((DIRECTIONS, 4), np.uint64)
    for side, axis in enumerate((u, -u, np.cross(bins, u), -np.cross(bins, u))):
        beyond = axis @ bins.T > 1e-6  # not q itself
        sides[:, side] = (beyond * (np.uint64(1) << np.arange(DIRECTIONS, dtype=np.uint64))).sum(
            axis=1, dtype=np.uint64
        )
    return sides


@kernel
def lost_renderability(
    voxels: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],  # [V, 3] centres, [V] bits, [V] h, [V] d_min
    poses: np.ndarray,  # [K, 4, 4] world_from_camera
    lens: Lens,
    surface: np.ndarray,  # [K, h, w] metres, depth of the rendered surface, inf = none
    directions: np.ndarray,  # [64, 3] unit, one for each bit
    sides: np.ndarray,  # [64, 4] uint64, see `surrounding`
) -> np.ndarray:  # [K, 2]
    """Return the sum of 1 - R over the surface voxels that each candidate sees, and the number of these voxels.

    R is the renderability (`r3_recon`).
    ``voxels`` are centres, direction bits, h and d_min of the surface voxels.
    """
    centres, bits, certainty, nearest = voxels
    count, height, width = surface.shape
    result = np.zeros((count, 2))
    for k in range(count):
        pose = poses[k]
        for v in range(len(centres)):
            x, y, z = pose[0, 3] - centres[v, 0], pose[1, 3] - centres[v, 1], pose[2, 3] - centres[v, 2]
            deep = -(pose[0, 2] * x + pose[1, 2] * y + pose[2, 2] * z)
            if deep <= 0.0:
                continue
            column = lens[2] - lens[0] * (pose[0, 0] * x + pose[1, 0] * y + pose[2, 0] * z) / deep
            row = lens[3] - lens[1] * (pose[0, 1] * x + pose[1, 1] * y + pose[2, 1] * z) / deep
            if not (0.0 <= column < width and 0.0 <= row < height):
                continue
            if is_hidden(deep, surface[k], int(row), int(column)):
                continue
            distance = np.sqrt(x * x + y * y + z * z)
            cosine, best, left, at = 0.0, 0, bits[v], 0
            while left:
                if left & np.uint64(1):
                    along = x * directions[at, 0] + y * directions[at, 1] + z * directions[at, 2]
                    if along > cosine * distance:
                        cosine, best = along / distance, at
                left >>= np.uint64(1)
                at += 1
            h, surrounded = certainty[v], True
            for side in range(4):
                surrounded &= bits[v] & sides[best, side] != 0
            if not surrounded:
                cosine, h = cosine * cosine, h * h
            cosine, h = min(cosine, 1.0), min(max(h, 0.0), 1.0)
            kept = min(1.0, distance / nearest[v]) if nearest[v] > 0.0 else 1.0  # 1 - s
            result[k, 0] += 1.0 - h ** (1.0 - cosine) * cosine * kept ** (1.0 - cosine * h)
            result[k, 1] += 1.0
    return result
