"""How wrong the map's pictures are where keyframes saw something, gathered by voxels."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping import KeyframeMapper
from activestructure_gym.splatting import Rendering
from activestructure_gym.volume import VoxelVolume

LOSS_KEYFRAMES = 16  # rendered per step, half of them the newest ones: the cost does not grow with the episode
Error = Callable[[Frame, Rendering], np.ndarray]  # of every pixel, [H, W]


def squared_colour_error(frame: Frame, shown: Rendering) -> np.ndarray:  # [H, W]
    """Mean over the colours."""
    return np.asarray(((shown.color - frame.rgb / 255.0) ** 2).mean(axis=-1))


def squared_depth_error(frame: Frame, shown: Rendering) -> np.ndarray:  # [H, W] m^2
    """Of the accumulated depth over the opacity, as the map is trained to it."""
    return np.asarray((shown.depth / np.maximum(shown.alpha, 1e-6) - frame.depth) ** 2)


def voxel_sums(
    mapper: KeyframeMapper, volume: VoxelVolume, error: Error
) -> tuple[np.ndarray, np.ndarray]:  # [X, Y, Z] sum of the errors, [X, Y, Z] pixels
    """Over the pixels whose measured surface lies in each voxel, of 16 keyframes: half of them the newest ones.

    The map is drawn as it is now, so that nothing has to be kept and nothing is out of date.
    """
    sums, number = np.zeros(volume.state.size), np.zeros(volume.state.size)
    for index in spread(len(mapper.keyframes), LOSS_KEYFRAMES):
        frame = mapper.keyframes[index]
        measured, pose = frame.depth > 0, frame.world_from_camera
        errors = error(frame, mapper.render(frame.camera, pose))[measured]
        points = frame.camera.backproject(frame.depth)[measured].astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
        inside = volume.contains(points)
        flat = np.ravel_multi_index(tuple(volume.voxel_of(points[inside]).T), volume.shape)
        sums += np.bincount(flat, errors[inside], len(sums))
        number += np.bincount(flat, minlength=len(sums))
    return sums.reshape(volume.shape), number.reshape(volume.shape)


def voxel_colour_errors(mapper: KeyframeMapper, volume: VoxelVolume) -> np.ndarray:  # [X, Y, Z] float32
    """Mean squared error of the rendered colours over what 16 keyframes saw in each voxel; 0 where they saw nothing."""
    sums, number = voxel_sums(mapper, volume, squared_colour_error)
    return (sums / np.maximum(number, 1.0)).astype(np.float32)


def spread(count: int, most: int) -> list[int]:
    """At most ``most`` of the indices below ``count``: half of them the last ones, the others evenly over the rest."""
    newest = range(max(0, count - most // 2), count)
    rest = count - len(newest)
    others = np.unique(np.linspace(0, rest - 1, min(rest, most - len(newest))).round().astype(int))
    return [int(i) for i in others] + list(newest)
