"""Compute the arrays that a run stores for its pictures: held-out views and the plan of the mapped volume."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from activestructure_gym.evaluation.metrics import psnr

if TYPE_CHECKING:
    from activestructure_gym.evaluation.protocols import CameraPath, StandardProtocol, Truth
    from activestructure_gym.mapping import GaussianMap
    from activestructure_gym.reconstruction import Reconstruction
    from activestructure_gym.worlds import StoredCaptures

STORED_VIEWS = 8  # number of stored held-out views: the first ones, whose order is random
_PIXELS_PER_METRE = 90
_MAX_SIDE_PX = 640  # pixels; larger scenes are drawn at a smaller scale
_BAND_M = 0.5  # metres; the plan shows the voxels up to this distance above and below the height of the start
_HEADROOM_M = 0.35  # metres above the start's height; Gaussians above (ceiling, lamps) would hide the rest
_ALTITUDE = 60.0  # height of the virtual camera in scene widths: its rays are almost parallel


def held_out_pictures(
    protocol: StandardProtocol, truth: Truth, gaussians: GaussianMap, measured: Sequence[float]
) -> dict[str, np.ndarray]:
    """Return rendered and true images of the first held-out views, and their PSNR.

    ``measured`` is the PSNR of every view in dB. ``rendered`` and ``true`` are [n, H, W, 3] uint8, ``psnr`` is [n] dB.
    """
    count = min(STORED_VIEWS, len(truth.views))
    rendered = [protocol.picture(gaussians, truth, index) for index in range(count)]
    return {
        "rendered": np.stack([np.rint(255.0 * picture).astype(np.uint8) for picture in rendered]),
        "true": truth.views.rgb[:count],
        "psnr": np.asarray(measured[:count], dtype=np.float64),
    }


def captured_pictures(gaussians: GaussianMap, captures: StoredCaptures, path: CameraPath) -> dict[str, np.ndarray]:
    """Return rendered and captured images of keyframes at equal intervals: `held_out_pictures` without ground truth.

    ``true`` holds the captured images, so ``psnr`` is that of mapped views.
    """
    from activestructure_gym.splatting import cpu
    from activestructure_gym.worlds import frame_from

    count = min(STORED_VIEWS, len(path.keyframes))
    chosen = np.unique(np.linspace(0, len(path.keyframes) - 1, count).round().astype(int))
    rendered, captured = list[np.ndarray](), list[np.ndarray]()
    for number in chosen:
        pose = path.keyframes[number]
        taken = captures.frame(int(number))
        frame = frame_from(taken.rgb, taken.depth, taken.world_from_camera, path.camera, path.max_range)
        seen = cpu.render(gaussians.parameters, gaussians.count, path.camera, pose)
        rendered.append(np.rint(255.0 * np.clip(seen.color, 0.0, 1.0)).astype(np.uint8))
        captured.append(frame.rgb)
    pairs = [(_unit(one), _unit(other)) for one, other in zip(rendered, captured)]
    return {
        "rendered": np.stack(rendered),
        "true": np.stack(captured),
        "psnr": np.array([psnr(one, other) for one, other in pairs], dtype=np.float64),
    }


def _unit(rgb: np.ndarray) -> np.ndarray:
    return rgb.astype(np.float32) / np.float32(255.0)


def plan_arrays(reconstruction: Reconstruction) -> dict[str, np.ndarray]:
    """Return the arrays of ``plan.npz``: the plan of the voxel volume and the Gaussian map rendered from above."""
    from activestructure_gym.volume import FREE, OCCUPIED, UNKNOWN

    volume = reconstruction.volume
    voxel = volume.config.voxel_size
    height = float(reconstruction.trajectory[0][2, 3])
    low, high = (int(np.floor((height + side * _BAND_M - volume.origin[2]) / voxel)) for side in (-1, 1))
    band = volume.state[:, :, max(low, 0) : max(high + 1, 1)]
    state = np.full(band.shape[:2], UNKNOWN, np.uint8)
    state[(band == FREE).any(axis=2)] = FREE
    state[(band == OCCUPIED).any(axis=2)] = OCCUPIED
    corner = np.asarray(volume.origin[:2], np.float64)
    extent = np.array(state.shape) * voxel
    colour, alpha = _from_above(reconstruction, corner, extent, height)
    return {
        "plan_state": np.select([state == FREE, state == OCCUPIED], [1, 2], 0).astype(np.uint8),
        "plan_corner": corner,
        "plan_extent": extent,
        "above_rgb": colour,
        "above_alpha": alpha,
    }


def plan_scale(extent: np.ndarray) -> float:  # pixels per metre
    """Return the scale of a plan of ``extent`` [2] metres, in pixels per metre."""
    return min(_PIXELS_PER_METRE, _MAX_SIDE_PX / float(np.max(extent)))


def pixel_size(extent: np.ndarray, scale: float) -> tuple[int, int]:
    """Return width and height in pixels of a plan of ``extent`` [2] metres, at least 1 each."""
    return max(1, round(float(extent[0]) * scale)), max(1, round(float(extent[1]) * scale))


def _from_above(
    reconstruction: Reconstruction, corner: np.ndarray, extent: np.ndarray, height: float
) -> tuple[np.ndarray, np.ndarray]:  # [h, w, 3] uint8, [h, w] uint8
    """Render the map from above: colour and opacity, without Gaussians above the headroom."""
    from activestructure_gym.geometry import PinholeCamera, look_along
    from activestructure_gym.splatting import cpu

    gaussians = reconstruction.mapper.map
    below = gaussians.parameters[2, : gaussians.count] < height + _HEADROOM_M
    parameters = np.ascontiguousarray(gaussians.parameters[:, : gaussians.count][:, below])
    scale = plan_scale(extent)
    width, rows = pixel_size(extent, scale)
    altitude = _ALTITUDE * float(extent.max())
    focal = altitude * scale
    camera = PinholeCamera(width, rows, focal, focal, width / 2, rows / 2)
    eye = np.array([*(corner + extent / 2), height + altitude])
    seen = cpu.render(parameters, parameters.shape[1], camera, look_along(eye, np.array([0.0, 0.0, -1.0])))
    solid = seen.alpha > 1e-3
    colour = np.where(solid[..., None], seen.color / np.where(solid, seen.alpha, 1.0)[..., None], 0.0)
    return np.rint(255 * np.clip(colour, 0, 1)).astype(np.uint8), np.rint(255 * seen.alpha).astype(np.uint8)
