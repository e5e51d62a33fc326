"""Compute the expected unknown volume visible from a view, and from all keyframes of the path to it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.compiling.thread_team import TEAM, default_threads
from activestructure_gym.features.context import FeatureContext, grid_rays
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.motion import is_level
from activestructure_gym.splatting.counters import take_ticket
from activestructure_gym.volume import OCCUPIED, UNKNOWN

MEAN_DEPTH = 1.0  # metres, mean free path of a ray in unknown space
REACH = 6.0  # metres, length of a ray
SHORTLIST = 24  # number of views whose paths are evaluated
_SHELL = 2  # voxels; unknown voxels this near to an occupied one are not counted, since views do not make them free
_MIN_CHANCE = 0.02  # probability of visibility below which a ray ends
_HALF_TIME = 5.0  # frames of travel at which a view's score for the shortlist is halved, as in the shared travel term


@FEATURES.register("unknown_volume", columns=("", "way"), unit="m^3", low=0.0)
def unknown_volume(context: FeatureContext) -> np.ndarray:  # [K, 2]
    """Return the expected unknown volume visible from a view, and from all keyframes of the path to it.

    Target voxels are the unknown voxels that views can make known (`target_voxels`). The result sums their volumes
    times the probability of visibility. On a ray that crossed l metres of target voxels before, this probability is
    exp(-l / 1 m); behind an occupied voxel it is 0. A voxel that several rays cross counts once, with the largest
    probability. This is the occlusion-aware information of [delmerico2018] with a probability per metre. Counting views
    along the path follows [bircher2016].

    The path goes through known free space; its views are the keyframes that the episode would take. The second column
    is computed for 24 views without revisits: those with the largest first column times 1 / (1 + frames / 5). It is 0
    for the others. The Gaussian map is not rendered. Alternatives: docs/notebook/lab_notes.md.
    """
    poses, agent = context.world_from_camera, context.agent
    found = np.zeros((len(poses), 2))
    if not len(poses):
        return found
    found[:, 0] = opened_volume(context, poses, np.arange(len(poses) + 1))
    if agent is not None and is_level(agent.pose):  # paths turn by yaw and pitch only
        discount = 1.0 / (1.0 + agent.least_frames(poses) / _HALF_TIME)
        order = np.argsort(-found[:, 0] * discount, kind="stable")
        first = order[~context.revisits[order]][:SHORTLIST]
        paths = zip(first, agent.paths(context.volume, poses[first]))
        taken = [(row, path) for row, path in paths if path is not None]
        if taken:
            starts = np.cumsum([0, *(len(path.keyframes) for _, path in taken)])
            views = np.concatenate([path.keyframes for _, path in taken])
            found[[row for row, _ in taken], 1] = opened_volume(context, views, starts)
    return found


def opened_volume(
    context: FeatureContext,
    world_from_camera: np.ndarray,  # [V, 4, 4]
    starts: np.ndarray,  # [G + 1], index of the first view of each group
) -> np.ndarray:  # [G] m^3
    """Return the expected unknown volume visible from each group of views, for example the keyframes of a path.

    The poses of a group are consecutive. A voxel that several views of a group see counts once.
    """
    volume = context.volume
    origin, voxel_size, poses, rays = grid_rays(volume, context.camera, world_from_camera)
    space = _Space(volume.state, context.once(target_voxels), origin, voxel_size)
    views = _Views(poses, np.asarray(starts, np.int64), rays, min(REACH, context.max_range))
    result = np.zeros(len(starts) - 1)
    threads = max(1, min(default_threads(), len(result)))
    notes = _Notes(*(np.zeros((threads, *volume.shape), kind) for kind in (np.float32, np.int32)))
    TEAM.run(_open, (np.zeros(2, np.int64), space, views, MEAN_DEPTH, notes, result), threads)
    return result * voxel_size**3


class _Space(NamedTuple):
    """Hold the voxel grid for the kernel `_open`."""

    state: np.ndarray  # [X, Y, Z] uint8
    wanted: np.ndarray  # [X, Y, Z] bool, see `target_voxels`
    origin: np.ndarray  # [3] corner of voxel (0, 0, 0)
    voxel_size: float  # metres


class _Views(NamedTuple):
    """Hold G groups of V views, and the rays of a view."""

    poses: np.ndarray  # [V, 4, 4] world_from_camera
    starts: np.ndarray  # [G + 1] int64, index of the first view of each group
    rays: np.ndarray  # [h, w, 3] camera frame, depth 1
    reach: float  # metres along a ray


class _Notes(NamedTuple):
    """Hold the largest probability of every voxel in the group of views that each of T threads works on."""

    best: np.ndarray  # [T, X, Y, Z] float32, largest probability so far; valid where ``stamps`` is 1 + group
    stamps: np.ndarray  # [T, X, Y, Z] int32: 1 + index of the group that has last set ``best``


def target_voxels(context: FeatureContext) -> np.ndarray:  # [X, Y, Z] bool
    """Return which voxels are targets: all unobserved ones, and those of unknown state far from occupied voxels.

    Voxels of the second kind have been observed, but too poorly to be free. They are more than two voxels from any
    occupied one, and no ray without return crossed them (`VoxelVolume.no_return`). They block a passage that was seen
    only at grazing angles. No voxel behind them is unobserved, but the agent cannot pass until better views make them
    free.
    """
    volume = context.volume
    near_occupied = _dilated(volume.occupied)
    return np.asarray(volume.unobserved | ((volume.state == UNKNOWN) & ~near_occupied & ~volume.no_return))


def _dilated(mask: np.ndarray) -> np.ndarray:  # [X, Y, Z] bool, both
    """Return which voxels have a voxel of the mask at most two voxels away along every axis."""
    for axis in range(3):
        result = mask.copy()
        source, target = np.moveaxis(mask, axis, 0), np.moveaxis(result, axis, 0)
        for shift in range(1, _SHELL + 1):
            target[shift:] |= source[:-shift]
            target[:-shift] |= source[shift:]
        mask = result
    return mask


@kernel
def _open(
    tickets: np.ndarray,  # [2] int64, counters: groups started, threads started
    space: _Space,
    views: _Views,
    mean_depth: float,  # metres, mean free path of a ray in target voxels
    notes: _Notes,
    result: np.ndarray,  # [G] voxels, set
) -> None:
    """Set ``result`` to the sum over voxels of the largest probability of visibility, for each group of views.

    Rays have steps of half a voxel. If a ray raises the probability of a voxel, only the increase is added.
    """
    state, wanted, origin, voxel_size = space
    poses, starts, rays, reach = views
    thread: int = take_ticket(tickets, 1)  # type: ignore[call-arg]
    keep = np.exp(-0.5 * voxel_size / mean_depth)
    steps = int(reach / (0.5 * voxel_size))
    own, stamp = notes.best[thread], notes.stamps[thread]
    while True:
        g: int = take_ticket(tickets, 0)  # type: ignore[call-arg]
        if g >= len(result):
            return
        total = 0.0
        for v in range(starts[g], starts[g + 1]):
            pose = poses[v]
            from_x, from_y, from_z = (pose[:3, 3] - origin) / voxel_size
            for row in range(rays.shape[0]):
                for column in range(rays.shape[1]):
                    ray = rays[row, column]
                    scale = 0.5 / np.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
                    dx = (pose[0, 0] * ray[0] + pose[0, 1] * ray[1] + pose[0, 2] * ray[2]) * scale
                    dy = (pose[1, 0] * ray[0] + pose[1, 1] * ray[1] + pose[1, 2] * ray[2]) * scale
                    dz = (pose[2, 0] * ray[0] + pose[2, 1] * ray[1] + pose[2, 2] * ray[2]) * scale
                    x, y, z = from_x, from_y, from_z
                    chance = 1.0
                    for _ in range(steps):
                        x, y, z = x + dx, y + dy, z + dz
                        i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
                        if i < 0 or j < 0 or k < 0:
                            break
                        if i >= state.shape[0] or j >= state.shape[1] or k >= state.shape[2]:
                            break
                        if state[i, j, k] == OCCUPIED:
                            break
                        if not wanted[i, j, k]:
                            continue
                        known = own[i, j, k] if stamp[i, j, k] == g + 1 else np.float32(0.0)
                        here = np.float32(chance)
                        if here > known:
                            total += here - known
                            own[i, j, k], stamp[i, j, k] = here, g + 1
                        chance *= keep
                        if chance < _MIN_CHANCE:
                            break
        result[g] = total
