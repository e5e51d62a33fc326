"""Choose the start poses of a scene: spread over its free space, at camera height, with open views."""

from __future__ import annotations

import numpy as np

from activestructure_gym.geometry import look_along
from activestructure_gym.ground_truth.free_space import FreeSpace
from activestructure_gym.ground_truth.level_ground import CAMERA_HEIGHTS
from activestructure_gym.scenes.scene import Scene

START_POSES = 16  # maximum number of start poses per scene; the seed of an episode selects one
MIN_START_POSES = 8  # minimum number of positions to choose from; limits are relaxed until there are as many
# Metres of clearance; the first value with enough positions is used. The first is the radius that is marked as free
# around the start (MotionConfig.start_free_radius), the last is the clearance of paths.
_CLEARANCES = (0.6, 0.45, 0.35, 0.25, 0.2)
_VIEW_RANGE = 6.0  # metres; farther open space does not improve a view
_HEADINGS = 72  # number of tested headings, 5 degrees apart


def choose_start_poses(scene: Scene, space: FreeSpace) -> np.ndarray:  # [S, 4, 4] world_from_camera
    """Choose up to 16 level poses far apart, each facing the most open direction.

    The choice is deterministic. The first position is drawn with the scene's `draw_key` as seed, and each next
    one is the farthest from all chosen positions.
    """
    places = _places(space)
    rng = np.random.default_rng(int(scene.draw_key[:16], 16))
    chosen = [int(rng.integers(len(places)))]
    distance = np.linalg.norm(places - places[chosen[0]], axis=1)
    while len(chosen) < min(START_POSES, len(places)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return np.stack([look_along(position, _open_direction(scene, position)) for position in places[chosen]])


def _places(space: FreeSpace) -> np.ndarray:  # [N, 3] metres
    """Return centres of free voxels where an episode may start: at camera height above a floor, far from surfaces.

    The limits on height and clearance are relaxed step by step until at least `MIN_START_POSES` centres satisfy them.
    If no limits leave that many, the largest set found is returned, or else all free voxels.
    """
    standing = (space.height >= CAMERA_HEIGHTS[0]) & (space.height <= CAMERA_HEIGHTS[1])
    on_floor = standing & _above_floor(space)
    best = np.zeros((0, 3))
    for allowed in (on_floor, standing, space.height > 0.5, space.clearance > 0):
        for clearance in _CLEARANCES:
            found = space.centers(np.argwhere(allowed & (space.clearance >= clearance)))
            if len(found) >= MIN_START_POSES:
                return found
            best = found if len(found) > len(best) else best
    return best if len(best) else space.centers(space.free_voxels)


def _above_floor(space: FreeSpace) -> np.ndarray:  # [X, Y, Z] bool
    """Return which free voxels are above a floor, and not above a bed or a table.

    A floor is a level below at least a quarter as many columns of free space as the most common level. Every storey of
    a house thus counts, and a bed in a bedroom does not.
    """
    z = space.centers(np.zeros((1, 3)))[0, 2] + np.arange(space.clearance.shape[2]) * space.voxel_size
    below = z[None, None, :] - space.height  # height of the surface below, world metres
    usable = (space.clearance > 0) & np.isfinite(below)
    if not usable.any():
        return usable
    level = np.zeros(below.shape, dtype=np.int64)
    level[usable] = np.round((below[usable] - below[usable].min()) / 0.1).astype(np.int64)
    # Each column counts once per level; otherwise tall rooms would have more weight than low ones.
    columns = np.argwhere(usable)[:, :2]
    votes = np.unique(np.column_stack([columns, level[usable]]), axis=0)[:, 2]
    counts = np.bincount(votes, minlength=level.max() + 1)
    # The height of a floor can be at the border of two bins, so neighbouring bins are added.
    spread = counts + np.concatenate([counts[1:], [0]]) + np.concatenate([[0], counts[:-1]])
    return usable & (spread >= 0.25 * spread.max())[level]


def _open_direction(scene: Scene, position: np.ndarray) -> np.ndarray:  # [3]
    """Return the level unit direction with the largest mean distance to surfaces, averaged over 60 degrees."""
    angle = 2.0 * np.pi * np.arange(_HEADINGS) / _HEADINGS
    directions = np.stack([np.cos(angle), np.sin(angle), np.zeros(_HEADINGS)], axis=1)
    # A ray without a hit leaves the scene through a window or hole, where there is nothing to map.
    distance = scene.raycaster.cast(position, directions).distance
    view = np.where(np.isfinite(distance), np.minimum(distance, _VIEW_RANGE), 0.0)
    half = _HEADINGS // 12
    around = np.concatenate([view[-half:], view, view[:half]])
    return directions[np.convolve(around, np.ones(2 * half + 1), mode="valid").argmax()]
