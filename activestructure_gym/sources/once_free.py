"""Keep ActiveGAMER's exploration map, in which the first keyframe that tests a voxel decides it permanently."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt

from activestructure_gym.geometry import invert_rigid, transform_points
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.sources.base import SourceContext
from activestructure_gym.volume import VoxelVolume

UNTESTED, FOUND_FREE, FOUND_NEAR, FOUND_SURFACE = range(4)  # states of a voxel; all but the first are permanent


def decide_voxels(
    state: np.ndarray,  # [X, Y, Z] uint8, changed in place
    volume: VoxelVolume,  # the grid of ``state``; its content is not read
    frame: Frame,
    gap_m: float,  # metres
) -> None:
    """Decide the untested voxels in front of and at the surface of one depth image ([activegamer, code]).

    A voxel more than ``gap_m`` in front of the surface is free if it is also more than ``gap_m`` from the surface of
    earlier images, otherwise it is near. Afterwards, a voxel within one voxel size of the image's own depth is surface.
    """
    index = np.argwhere(state == UNTESTED)
    points = transform_points(invert_rigid(frame.world_from_camera), volume.center_of(index))
    inside = frame.camera.in_image(points)
    index, points = index[inside], points[inside]
    u, v = np.floor(frame.camera.project(points)).astype(np.int64).T
    depth = frame.depth[v, u]
    before = np.where(depth > 0, depth - points[:, 2], -np.inf)  # metres in front of the surface
    tested = tuple(index[before > gap_m].T)
    surface = state == FOUND_SURFACE
    if surface.any():
        metres = distance_transform_edt(~surface)[tested] * volume.voxel_size
        state[tested] = np.where(metres > gap_m + 1e-6, FOUND_FREE, FOUND_NEAR)
    else:
        state[tested] = FOUND_FREE
    state[tuple(index[np.abs(before) < volume.voxel_size].T)] = FOUND_SURFACE


def once_free(context: SourceContext, positions: np.ndarray, gap_m: float) -> np.ndarray:  # [P, 3] -> [P] bool
    """Return which positions are in voxels that a keyframe has found free, whatever later ones have shown.

    An untested voxel counts if it is at least ``gap_m`` from all occupied voxels. Such voxels are around the start,
    which no image shows.
    """
    volume, frames = context.volume, context.mapper.keyframes
    new = (np.full(volume.shape, UNTESTED, np.uint8), 0)
    state, known = context.mapper.memory.get(("once_free", gap_m), new)
    for frame in frames[known:]:
        decide_voxels(state, volume, frame, gap_m)
    context.mapper.memory["once_free", gap_m] = state, len(frames)
    apart = distance_transform_edt(~volume.occupied) * volume.voxel_size if volume.occupied.any() else np.inf
    free_now = (state == FOUND_FREE) | ((state == UNTESTED) & (apart >= gap_m))
    inside = volume.contains(positions)
    free = np.zeros(len(positions), bool)
    free[inside] = free_now[tuple(volume.voxel_of(positions[inside]).T)]
    return free
