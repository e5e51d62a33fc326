"""Track the pose of a frame by aligning it with earlier keyframes.

The reported pose is the initial value and a prior. Each surface point P of the reference keyframes is transformed into
the camera, p = T P, and compared with the frame at its pixel by two residuals:

    depth   n . (q - p)    the point-to-plane distance colour  C - I(p)

Here q is the point that the frame measures at that pixel, n and C are normal and colour of the reference point, and I
is the image of the frame. Both images are smoothed, less in each step.

The update is camera_from_world T <- Exp(xi) T with xi = (rho, phi). A point moves by rho + phi x p. So the rows of the
Gauss-Newton system are [n, p x n] and [g, p x g], where g is the gradient of the colour per metre. Depth determines the
three to five degrees of freedom that the visible planes constrain; colour determines the others.

The references are keyframes and not renderings of the map. After few optimiser steps per keyframe, the map has
systematic errors of millimetres to a centimetre at slanted walls and edges, which bias the pose. Measured pose errors
are 2 to 3 cm with the rendered map, and below 2 mm with keyframes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from activestructure_gym.geometry import PinholeCamera, invert_rigid, se3_exp, transform_points
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.ranges import check_ranges

_NEAR = 0.05  # metres, smallest depth of a point in view
_PROBES = 400  # number of pixels of the frame by which overlapping keyframes are found
_RANGES = {
    "iterations": "[0, 10000]",
    "references": "[1, 100000]",
    "pixels": "[1, 1e8]",
    "blurs_deg": "(0, 90]",
    "reaches": "(0, 1000]",
    **dict.fromkeys(("depth_sigma", "color_sigma", "converged"), "(0, 1000]"),
    **dict.fromkeys(("huber", "gate"), "(0, 1e9]"),
}


@dataclass(frozen=True)
class TrackingConfig:
    """Configure `track_pose`. All values are own choices; measurements are in docs/notebook/method.md."""

    iterations: int = 0  # largest number of Gauss-Newton steps; 0 = no tracking, 20 works well
    references: int = 10  # number of reference keyframes, those with the largest overlap (measured: 6 double the error)
    pixels: int = 3600  # pixels per reference keyframe, on a grid; fewer in smaller images
    # Degrees: sigma of the image smoothing in each step; the last value repeats.
    blurs_deg: tuple[float, ...] = (1.8, 1.4, 1.1, 0.7, 0.35)
    # Metres: largest depth residual in each step; the last value repeats.
    reaches: tuple[float, ...] = (0.2, 0.2, 0.1, 0.05)
    depth_sigma: float = 0.001  # metres, smallest scale of depth residuals; their measured spread is used if larger
    color_sigma: float = 0.02  # smallest scale of colour residuals in 0..1; their measured spread is used if larger
    huber: float = 1.345  # residual in scales above which the loss is linear (95 % efficiency for Gaussian noise)
    converged: float = 1e-4  # metres and radians; a shorter step ends the iteration
    gate: float = 4.0  # largest deviation from the reported pose, in expected errors

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES, "tracking ")


@dataclass(frozen=True)
class TrackedPose:
    """Hold the result of `track_pose`."""

    world_from_camera: np.ndarray  # [4, 4]
    steps: int  # Gauss-Newton steps taken
    points: int  # reference points compared in the last step
    believed: bool  # False: too little overlap or too far from the reported pose, which is returned instead


@dataclass(frozen=True)
class _References:
    points: np.ndarray  # [n, 3] metres, world
    normals: np.ndarray  # [n, 3] world
    colors: np.ndarray  # [blurs, n, 3] 0..1, one per image smoothing


def track_pose(
    frame: Frame,  # with its reported pose
    keyframes: Sequence[Frame],  # with the poses used for mapping
    config: TrackingConfig,
    *,
    sigma_m: float,  # metres per axis, expected error of the reported position
    sigma_deg: float,  # degrees per axis, expected error of the reported rotation
) -> TrackedPose:
    """Return the pose of a frame, found by alignment with the keyframes that overlap with it most.

    The reported pose is returned if there is no overlap, or if the result deviates from it by more than ``config.gate``
    expected errors.

    Parameters
    ----------
    frame : Frame
        The frame, with the reported pose.
    keyframes : sequence of Frame
        The keyframes, with the poses used for mapping.
    config : TrackingConfig
        The constants.
    sigma_m : float
        Expected error of the reported position per axis, in metres.
    sigma_deg : float
        Expected error of the reported rotation per axis, in degrees.

    Returns
    -------
    TrackedPose
        The pose, and whether it was tracked.
    """
    camera, reported = frame.camera, invert_rigid(frame.world_from_camera)
    chosen = shared_keyframes(frame, keyframes, limit=config.references, reach=config.reaches[0])
    unchanged = TrackedPose(frame.world_from_camera, 0, 0, believed=False)
    if not chosen:
        return unchanged
    references = _collect([keyframes[k] for k in chosen], config.blurs_deg, config.pixels)
    levels = [_with_slopes(_smoothed(frame, blur)) for blur in config.blurs_deg]
    rays = camera.rays().astype(np.float64)
    spread = np.maximum(np.repeat([sigma_m, np.radians(sigma_deg)], 3), 1e-6)

    pose, points, steps = reported, 0, 0
    for step in range(config.iterations):
        level = min(step, len(levels) - 1)
        reach = config.reaches[min(step, len(config.reaches) - 1)]
        index, place, pixel, by_depth = _seen(pose, references, frame, rays, reach)
        points, steps = len(index), step + 1
        if points < 6:
            return unchanged
        normals = references.normals[index] @ pose[:3, :3].T
        matrix, vector = np.diag(spread**-2), -_tangent(pose @ invert_rigid(reported)) / spread**2
        for rows, residuals, least in (
            (_rows(normals, place), by_depth, config.depth_sigma),
            (*_color_terms(levels[level], references.colors[level, index], place, pixel, camera), config.color_sigma),
        ):
            weights = _robust_weights(residuals, least, config.huber)
            matrix += rows.T @ (rows * weights[:, None])
            vector += rows.T @ (weights * residuals)
        xi = np.linalg.solve(matrix, vector)
        pose = se3_exp(xi) @ pose
        final = step >= max(len(levels), len(config.reaches)) - 1
        if final and max(np.linalg.norm(xi[:3]), np.linalg.norm(xi[3:])) < config.converged:
            break
    away = _tangent(pose @ invert_rigid(reported)) / spread
    if max(np.linalg.norm(away[:3]), np.linalg.norm(away[3:])) > config.gate:
        return TrackedPose(frame.world_from_camera, steps, points, believed=False)
    return TrackedPose(invert_rigid(pose), steps, points, believed=True)


def shared_keyframes(frame: Frame, keyframes: Sequence[Frame], *, limit: int, reach: float) -> list[int]:
    """Return the ``limit`` keyframes that overlap most with a frame: they see the same surface points.

    A keyframe sees a point of the frame if its depth there differs by less than ``reach`` metres.
    """
    measured = np.flatnonzero(frame.depth)
    if not len(measured):
        return []
    drawn = measured[np.linspace(0, len(measured) - 1, _PROBES).astype(int)]
    points = transform_points(
        frame.world_from_camera, frame.camera.backproject(frame.depth).reshape(-1, 3)[drawn].astype(np.float64)
    )
    shares = np.empty(len(keyframes))
    for k, keyframe in enumerate(keyframes):
        seen = transform_points(invert_rigid(keyframe.world_from_camera), points)
        row, column, inside = _pixels(seen, keyframe.camera)
        depth = keyframe.depth[row, column]
        shares[k] = np.mean(inside & (depth > 0) & (np.abs(depth - seen[:, 2]) < reach))
    order = np.argsort(-shares, kind="stable")[:limit]
    return [int(k) for k in order if shares[k] > 0.02]


def _pixels(points: np.ndarray, camera: PinholeCamera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return row, column and whether inside the image for points [n, 3] in the camera frame; 0 and 0 outside."""
    z = points[:, 2]
    safe = np.where(z > _NEAR, z, 1.0)
    column = np.floor(camera.fx * points[:, 0] / safe + camera.cx)
    row = np.floor(camera.fy * points[:, 1] / safe + camera.cy)
    inside = (z > _NEAR) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    return np.where(inside, row, 0).astype(int), np.where(inside, column, 0).astype(int), inside


def _collect(keyframes: Sequence[Frame], blurs_deg: Sequence[float], pixels: int) -> _References:
    points, normals, colors = [], [], []
    for keyframe in keyframes:
        own_points, own_normals, defined = surface_normals(keyframe.depth, keyframe.camera)
        stride = max(1, int(np.ceil(np.sqrt(defined.size / pixels))))
        grid = np.zeros_like(defined)
        grid[stride // 2 :: stride, stride // 2 :: stride] = True
        used = defined & grid
        pose = keyframe.world_from_camera
        points.append(transform_points(pose, own_points[used].astype(np.float64)))
        normals.append(own_normals[used].astype(np.float64) @ pose[:3, :3].T)
        colors.append(np.stack([_smoothed(keyframe, blur)[used] for blur in blurs_deg]))
    return _References(np.concatenate(points), np.concatenate(normals), np.concatenate(colors, axis=1))


def surface_normals(
    depth: np.ndarray,  # [H, W] metres, 0 = no return
    camera: PinholeCamera,
    *,
    max_bend: float = 0.02,  # largest second difference of 1 / depth, divided by 1 / depth; 0 on a plane
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # points [H, W, 3], normals [H, W, 3], defined [H, W] bool
    """Return points and unit normals (towards the camera) by central differences.

    They are undefined at image borders, depth edges and holes.
    """
    points = camera.backproject(depth)
    inverse = np.where(depth > 0, 1.0 / np.where(depth > 0, depth, 1.0), 0.0)
    middle, after, before = slice(1, -1), slice(2, None), slice(None, -2)
    per_column = points[middle, after] - points[middle, before]
    per_row = points[after, middle] - points[before, middle]
    cross = np.cross(per_row, per_column)
    length = np.linalg.norm(cross, axis=-1)
    normals, defined = np.zeros_like(points), np.zeros(depth.shape, bool)
    normals[middle, middle] = cross / np.maximum(length, 1e-20)[..., None]
    center, good = inverse[middle, middle], length > 0
    for one, other in (
        (inverse[middle, before], inverse[middle, after]),
        (inverse[before, middle], inverse[after, middle]),
    ):
        good &= (one > 0) & (other > 0) & (np.abs(one + other - 2.0 * center) < max_bend * center)
    defined[middle, middle] = good
    return points, normals, defined


def _seen(
    pose: np.ndarray, references: _References, frame: Frame, rays: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the reference points that the frame sees: index, camera point, pixel (column, row), depth residual.

    ``pose`` is camera_from_world. ``rays`` [H, W, 3] are the camera's rays, and a larger depth residual than ``reach``
    metres excludes a point.
    """
    camera = frame.camera
    place = transform_points(pose, references.points)
    row, column, inside = _pixels(place, camera)
    inside &= (row > 0) & (row < camera.height - 1) & (column > 0) & (column < camera.width - 1)
    index = np.flatnonzero(inside)
    place, row, column = place[index], row[index], column[index]
    depth = frame.depth[row, column]
    measured = rays[row, column] * depth[:, None]
    normals = references.normals[index] @ pose[:3, :3].T
    residual = np.einsum("ij,ij->i", normals, measured - place)
    same = (depth > 0) & (np.abs(residual) < reach) & (np.abs(depth - place[:, 2]) < 2.0 * reach)
    same &= np.einsum("ij,ij->i", normals, place) < 0
    index, place = index[same], place[same]
    focal, middle = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    return index, place, focal * place[:, :2] / place[:, 2:] + middle, residual[same]


def _color_terms(
    image: np.ndarray,  # [H, W, 9] colour, its change per column, its change per row
    colors: np.ndarray,  # [n, 3] colours of the reference points
    place: np.ndarray,  # [n, 3] metres, camera frame
    pixel: np.ndarray,  # [n, 2] column and row; centres of pixels are at + 0.5
    camera: PinholeCamera,
) -> tuple[np.ndarray, np.ndarray]:  # derivatives by the pose [3 n, 6], residuals [3 n]
    values = _bilinear(image, pixel - 0.5)
    per_x = values[:, 3:6] * (camera.fx / place[:, 2:])
    per_y = values[:, 6:9] * (camera.fy / place[:, 2:])
    per_z = -(per_x * place[:, :1] + per_y * place[:, 1:2]) / place[:, 2:]
    slopes = np.stack([per_x, per_y, per_z], axis=-1).reshape(-1, 3)
    return _rows(slopes, np.repeat(place, 3, axis=0)), (colors - values[:, :3]).reshape(-1)


def _rows(direction: np.ndarray, place: np.ndarray) -> np.ndarray:  # [n, 3], [n, 3] -> [n, 6]
    """Return the derivative of direction . (rho + phi x place) with respect to (rho, phi)."""
    return np.concatenate([direction, np.cross(place, direction)], axis=1)


def _robust_weights(residuals: np.ndarray, least: float, huber: float) -> np.ndarray:
    """Return Huber weights / variance of residuals, with the standard deviation from their median absolute value.

    The standard deviation is at least ``least``; ``huber`` is the threshold in standard deviations.
    """
    scale = max(least, 1.4826 * float(np.median(np.abs(residuals))))
    return np.minimum(1.0, huber * scale / np.maximum(np.abs(residuals), 1e-12)) / scale**2


def _smoothed(frame: Frame, blur_deg: float) -> np.ndarray:  # [H, W, 3] float32 0..1
    """Return the image smoothed with a sigma of ``blur_deg`` degrees, so that image sizes do not affect the detail."""
    import cv2

    sigma = blur_deg * np.pi / 180.0 * frame.camera.fx  # pixels
    return cv2.GaussianBlur(frame.rgb.astype(np.float32) / 255.0, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)


def _with_slopes(image: np.ndarray) -> np.ndarray:  # [H, W, 3] -> [H, W, 9]: image, change per column, change per row
    per_column, per_row = np.zeros_like(image), np.zeros_like(image)
    per_column[:, 1:-1] = 0.5 * (image[:, 2:] - image[:, :-2])
    per_row[1:-1] = 0.5 * (image[2:] - image[:-2])
    return np.concatenate([image, per_column, per_row], axis=2)


def _bilinear(image: np.ndarray, at: np.ndarray) -> np.ndarray:  # [H, W, c], [n, 2] column and row -> [n, c]
    corner = np.floor(at).astype(int)
    share = (at - corner)[:, :, None]
    (column, row), (x, y) = corner.T, (share[:, 0], share[:, 1])
    upper = image[row, column] * (1.0 - x) + image[row, column + 1] * x
    lower = image[row + 1, column] * (1.0 - x) + image[row + 1, column + 1] * x
    return upper * (1.0 - y) + lower * y


def _tangent(motion: np.ndarray) -> np.ndarray:  # [4, 4] -> [6] (rho, phi)
    """Return the logarithm of a small rigid transform, the inverse of `se3_exp` to first order in the rotation."""
    phi = Rotation.from_matrix(motion[:3, :3]).as_rotvec()
    return np.concatenate([motion[:3, 3] - 0.5 * np.cross(phi, motion[:3, 3]), phi])
