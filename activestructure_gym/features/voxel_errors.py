"""Sum the rendering errors of keyframes per voxel; an error belongs to the voxel of the pixel's measured surface."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping import KeyframeMapper
from activestructure_gym.splatting import Rendering
from activestructure_gym.volume import VoxelVolume

LOSS_KEYFRAMES = 16  # keyframes rendered per step, half of them the newest; a constant number bounds the cost
Error = Callable[[Frame, Rendering], np.ndarray]  # returns the error of every pixel [H, W]


def squared_colour_error(frame: Frame, shown: Rendering) -> np.ndarray:  # [H, W]
    """Return the squared error of the rendered colour of each pixel in 0..1, averaged over the three channels."""
    return np.asarray(((shown.color - frame.rgb / 255.0) ** 2).mean(axis=-1))


def squared_depth_error(frame: Frame, shown: Rendering) -> np.ndarray:  # [H, W] m^2
    """Return the squared error of the rendered depth of each pixel: accumulated depth divided by alpha."""
    return np.asarray((shown.depth / np.maximum(shown.alpha, 1e-6) - frame.depth) ** 2)


def voxel_sums(
    mapper: KeyframeMapper, volume: VoxelVolume, error: Error
) -> tuple[np.ndarray, np.ndarray]:  # [X, Y, Z] sum of the errors, [X, Y, Z] pixels
    """Return, per voxel, the sum of ``error`` and the number of pixels whose measured surface point is in the voxel.

    The pixels are those of `LOSS_KEYFRAMES` keyframes, chosen by `spread` and rendered from the current map.
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
    """Return the mean squared colour error of the pixels in each voxel, over 16 keyframes; 0 without pixels."""
    sums, number = voxel_sums(mapper, volume, squared_colour_error)
    return (sums / np.maximum(number, 1.0)).astype(np.float32)


def spread(count: int, most: int) -> list[int]:
    """Return at most ``most`` indices below ``count``: the last ``most // 2``, and evenly spaced ones of the rest."""
    newest = range(max(0, count - most // 2), count)
    rest = count - len(newest)
    others = np.unique(np.linspace(0, rest - 1, min(rest, most - len(newest))).round().astype(int))
    return [int(i) for i in others] + list(newest)
