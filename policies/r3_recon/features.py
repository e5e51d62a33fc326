"""R3-RECON: how well a view could be rendered from what was seen of each place, and unexplored space ([r3_recon])."""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.unexplored import unexplored, unknown_cells
from activestructure_gym.geometry import fibonacci_directions
from activestructure_gym.geometry.camera import Lens
from activestructure_gym.policies.r3_recon.surface_views import DIRECTIONS, SurfaceViews

EXPLORATION = 1000.0  # what an unexplored voxel is worth beside one of surface that nothing is known of
UNEXPLORED_VOXEL = 0.2  # metres, side of the unexplored voxels that are counted
COLOUR_SCALE = 1.154  # 2 / sqrt(3): colours half black and half white have no renderability
FINE = 0.01 / 5.0  # metres per pixel: who was so near need not come nearer
SLACK_M, SLACK_SHARE = 0.05, 0.05  # a voxel so far behind the map's surface, and this share of its depth, is seen


@FEATURES.register("r3_recon", unit="weighted share of the voxels", low=0.0)
def r3_recon(context: FeatureContext) -> np.ndarray:  # [K]
    """U = #unexplored voxels in sight / #voxels + sum over the surface voxels in sight of 1 - R, over 1000 #voxels.

    R = h^(1 - a) a (1 - s)^(1 - a h), the renderability of a place from a side ([r3_recon, code]):

    - a = max(0, cos) of the angle to the nearest of the directions that keyframes saw it from (64 bins);
    - h = 1 - 1.154 sqrt(trace of the covariance of the colours they saw), in 0..1: 1 where all saw the same;
    - s = max(0, 1 - d / d_min): how much nearer than any keyframe the view is, 0 where a keyframe was so near that 1 cm
      fills 5 pixels.

    Surface voxels of 5 cm in sight are those whose centre projects into the image and does not lie behind what the map
    shows there. Unexplored ones are those of `unexplored`, in units of 0.2 m; the original adds without a divisor.
    """
    volume = context.volume
    voxels = unknown_cells(volume)[2] * (volume.config.voxel_size / UNEXPLORED_VOXEL) ** 3
    looks = context.episode(_surface_views).update(context.mapper.keyframes)
    certainty = np.clip(1.0 - COLOUR_SCALE * np.sqrt(looks.spread), 0.0, 1.0)
    frames = context.mapper.keyframes
    fine = FINE * frames[-1].camera.fx if frames else 0.0
    nearest = np.where(looks.nearest < fine, 0.0, looks.nearest)
    with np.errstate(divide="ignore", invalid="ignore"):
        surface = np.where(context.alpha > context.coverage_alpha, context.depth / context.alpha, np.float32(np.inf))
    unsure = lost_renderability(
        (looks.centres, looks.directions, certainty, nearest),
        np.ascontiguousarray(context.world_from_camera, dtype=np.float64),
        context.camera.lens,
        surface * (1.0 + SLACK_SHARE) + SLACK_M,
        fibonacci_directions(DIRECTIONS),
        context.max_range,
    )
    return unexplored(context) + unsure / (EXPLORATION * voxels)


def _surface_views(context: FeatureContext) -> SurfaceViews:
    return SurfaceViews()


@kernel
def lost_renderability(
    voxels: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],  # [V, 3] centres, [V] bits, [V] h, [V] d_min
    poses: np.ndarray,  # [K, 4, 4] world_from_camera
    lens: Lens,
    surface: np.ndarray,  # [K, h, w] metres of depth behind which nothing is seen
    directions: np.ndarray,  # [64, 3] unit, of the bits
    farthest: float,  # metres of depth
) -> np.ndarray:  # [K] sum of 1 - R over the voxels in sight
    centres, bits, certainty, nearest = voxels
    count, height, width = surface.shape
    result = np.zeros(count)
    for k in range(count):
        pose = poses[k]
        for v in range(len(centres)):
            x, y, z = pose[0, 3] - centres[v, 0], pose[1, 3] - centres[v, 1], pose[2, 3] - centres[v, 2]
            deep = -(pose[0, 2] * x + pose[1, 2] * y + pose[2, 2] * z)
            if not 0.0 < deep < farthest:
                continue
            column = lens[2] - lens[0] * (pose[0, 0] * x + pose[1, 0] * y + pose[2, 0] * z) / deep
            row = lens[3] - lens[1] * (pose[0, 1] * x + pose[1, 1] * y + pose[2, 1] * z) / deep
            if not (0.0 <= column < width and 0.0 <= row < height) or deep > surface[k, int(row), int(column)]:
                continue
            distance = np.sqrt(x * x + y * y + z * z)
            cosine, left, at = 0.0, bits[v], 0
            while left:
                if left & np.uint64(1):
                    along = x * directions[at, 0] + y * directions[at, 1] + z * directions[at, 2]
                    cosine = max(cosine, along / distance)
                left >>= np.uint64(1)
                at += 1
            cosine = min(cosine, 1.0)
            h = certainty[v]
            kept = min(1.0, distance / nearest[v]) if nearest[v] > 0.0 else 1.0  # 1 - s
            result[k] += 1.0 - h ** (1.0 - cosine) * cosine * kept ** (1.0 - cosine * h)
    return result
