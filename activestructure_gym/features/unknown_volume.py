"""The unknown space that a view, and the way to it, would open."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from activestructure_gym.compiling import kernel
from activestructure_gym.compiling.thread_team import TEAM, default_threads
from activestructure_gym.features.context import FeatureContext, grid_rays
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.motion import is_level
from activestructure_gym.splatting.counters import take_ticket
from activestructure_gym.volume import OCCUPIED, UNKNOWN

MEAN_DEPTH = 1.0  # metres that a ray gets into unknown space, on average, before something stops it
REACH = 6.0  # metres along a ray
SHORTLIST = 24  # views whose ways are looked along
_COLUMNS = 40  # of rays in a view, about
_SHELL = 2  # voxels around anything occupied that further looks do not clear
_MIN_CHANCE = 0.02  # of a ray to have come so far: it is not followed any longer
_HALF_TIME = 5.0  # frames after which a view counts half for the shortlist, as in the shared travel term


@FEATURES.register("unknown_volume", columns=("", "way"), unit="m^3", low=0.0)
def unknown_volume(context: FeatureContext) -> np.ndarray:  # [K, 2]
    """Unknown space that a view would look into, and that the whole way to it would.

    The sum over the voxels of `worth_a_look` of their volume times the chance to see into them: exp(-l / 1 m) for a ray
    that went through l metres of such voxels before, 0 behind an occupied one; of all rays the largest. So a voxel
    counts once, however many rays and views of a way meet it. The occlusion-aware information of [delmerico2018] with
    a chance per metre; that what is seen on the way counts is [bircher2016]'s.

    The way goes through known free space, and its views are the keyframes that the episode would take. The second
    column is that of the 24 views with the largest first one by frames, 1 / (1 + frames / 5), without revisits; else 0.
    Nothing of the Gaussian map is rendered. What was tried beside it: docs/notebook/exploration.md.
    """
    poses, agent = context.world_from_camera, context.agent
    found = np.zeros((len(poses), 2))
    if not len(poses):
        return found
    found[:, 0] = opened_volume(context, poses, np.arange(len(poses) + 1))
    if agent is not None and is_level(agent.pose):  # ways turn by yaw and pitch alone
        discount = 1.0 / (1.0 + agent.least_frames(poses) / _HALF_TIME)
        order = np.argsort(-found[:, 0] * discount, kind="stable")
        first = order[~context.revisits[order]][:SHORTLIST]
        taken = [(row, way) for row, way in zip(first, agent.paths(context.volume, poses[first])) if way is not None]
        if taken:
            starts = np.cumsum([0, *(len(way.keyframes) for _, way in taken)])
            views = np.concatenate([way.keyframes for _, way in taken])
            found[[row for row, _ in taken], 1] = opened_volume(context, views, starts)
    return found


def opened_volume(
    context: FeatureContext,
    world_from_camera: np.ndarray,  # [V, 4, 4]
    starts: np.ndarray,  # [G + 1], where each group of views begins
) -> np.ndarray:  # [G] m^3
    """Unknown space that each group of views would look into together."""
    volume = context.volume
    stride = max(1, round(context.camera.width / _COLUMNS))
    origin, voxel_size, poses, rays = grid_rays(volume, context.camera, world_from_camera, stride)
    space = _Space(volume.state, context.once(worth_a_look), origin, voxel_size)
    views = _Views(poses, np.asarray(starts, np.int64), rays, min(REACH, context.max_range))
    result = np.zeros(len(starts) - 1)
    threads = max(1, min(default_threads(), len(result)))
    notes = _Notes(*(np.zeros((threads, *volume.shape), kind) for kind in (np.float32, np.int32)))
    TEAM.run(_open, (np.zeros(2, np.int64), space, views, MEAN_DEPTH, notes, result), threads)
    return result * voxel_size**3


class _Space(NamedTuple):
    """The voxel grid."""

    state: np.ndarray  # [X, Y, Z] uint8
    wanted: np.ndarray  # [X, Y, Z] bool, see `worth_a_look`
    origin: np.ndarray  # [3] corner of voxel (0, 0, 0)
    voxel_size: float  # metres


class _Views(NamedTuple):
    """Groups of views and the rays of each."""

    poses: np.ndarray  # [V, 4, 4] world_from_camera
    starts: np.ndarray  # [G + 1] int64, where each group begins
    rays: np.ndarray  # [h, w, 3] camera frame, depth 1
    reach: float  # metres along a ray


class _Notes(NamedTuple):
    """What each thread has found out about the group it is at."""

    best: np.ndarray  # [T, X, Y, Z] float32, the largest chance so far, where the stamp is the group's
    stamps: np.ndarray  # [T, X, Y, Z] int32: 1 + group


def worth_a_look(context: FeatureContext) -> np.ndarray:  # [X, Y, Z] bool
    """Voxels that nobody has looked into, and open space that was looked through and is not proven free.

    The second, unknown and more than two voxels away from anything occupied, is what closes a passage that all looks so
    far grazed: nothing is unobserved behind it, and the agent may not go there until better looks have proven it free.
    """
    volume = context.volume
    beside = ndimage.maximum_filter(volume.occupied, size=2 * _SHELL + 1)
    return np.asarray(volume.unobserved | ((volume.state == UNKNOWN) & ~beside))


@kernel
def _open(
    tickets: np.ndarray,  # [2] int64: groups that threads have taken, threads
    space: _Space,
    views: _Views,
    mean_depth: float,  # metres
    notes: _Notes,
    result: np.ndarray,  # [G] voxels, written to
) -> None:
    """Rays in steps of half a voxel; a chance that rises adds what it rises by, so the sum is that of the largest."""
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
