"""Pose tracking: the pose of a frame, found by aligning it with earlier keyframes.

The reported pose is the start and a prior. Every point of the reference keyframes is moved into the frame's camera,
p = T P, and compared with the frame at the pixel where it appears, by two residuals:

    depth   n . (q - p)    q the point measured at that pixel, n the reference's normal (point to plane)
    colour  C - I(p)       the reference's colour and the frame's, smoothed less from step to step

With camera_from_world T <- Exp(xi) T, xi = (rho, phi), a point moves by rho + phi x p, and the rows of the Gauss-Newton
system are [n, p x n] and [g, p x g], g the slope of the brightness per metre. Depth alone fixes the three to five
degrees of freedom that the planes in view determine; colour fixes the others.

The references are the frames themselves and not what the map shows: a map of a few steps per keyframe is off by
millimetres to a centimetre at slanted walls and edges, always to the same side, and the pose follows it (measured: 2 to
3 cm against the rendered map, below 2 mm against keyframes).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from activestructure_gym.geometry import PinholeCamera, invert_rigid, se3_exp, transform_points
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.ranges import check_ranges

_NEAR = 0.05  # metres
_PROBES = 400  # pixels of the frame by which references are chosen
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
    """Constants of `track_pose`. All choices are our own; "measured": as in the project's docs, method."""

    iterations: int = 0  # Gauss-Newton steps at most; 0 = believe the reported pose. 20 is a good number
    references: int = 10  # keyframes compared with: those that share most with the frame (measured: 6 double the error)
    pixels: int = 3600  # of every reference, on a grid; fewer in smaller images
    blurs_deg: tuple[float, ...] = (1.8, 1.4, 1.1, 0.7, 0.35)  # of view, sigma of the smoothing per step, last repeats
    reaches: tuple[float, ...] = (0.2, 0.2, 0.1, 0.05)  # metres, more apart is another surface; per step, last repeats
    depth_sigma: float = 0.001  # metres, least scale of the depth residual (the residuals' own spread if larger)
    color_sigma: float = 0.02  # of the 0..1 range, least scale of the colour residual, as above
    huber: float = 1.345  # scales beyond which a residual counts linearly (95 % efficient on Gaussian noise)
    converged: float = 1e-4  # metres and radians; a shorter step is the last
    gate: float = 4.0  # times the expected error; a pose further from the reported one is not believed

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES, "tracking ")


@dataclass(frozen=True)
class TrackedPose:
    """The result of `track_pose`."""

    world_from_camera: np.ndarray  # [4, 4]
    steps: int  # Gauss-Newton steps taken
    points: int  # reference points compared in the last one
    believed: bool  # False: too little in common, or too far from the reported pose, which then stands


@dataclass(frozen=True)
class _References:
    points: np.ndarray  # [n, 3] metres, world
    normals: np.ndarray  # [n, 3] world
    colors: np.ndarray  # [levels, n, 3] 0..1


def track_pose(
    frame: Frame,  # its pose is the reported one
    keyframes: Sequence[Frame],  # with the poses they were mapped from
    config: TrackingConfig,
    *,
    sigma_m: float,  # metres per axis, expected error of the reported position
    sigma_deg: float,  # degrees per axis, as above for the rotation
) -> TrackedPose:
    """Align ``frame`` with the keyframes it shares most with.

    The reported pose is returned unchanged where there is nothing to compare with, or if the result lies further from
    it than ``config.gate`` expected errors.
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
    """The ``limit`` keyframes that see most of what ``frame`` sees: same pixel, depths within ``reach`` metres."""
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
    """Row, column (0 where outside) and whether inside, of points [n, 3] in the camera's frame."""
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
    most_bend: float = 0.02,  # of the depth: second difference of the inverse depth, which is linear on planes
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # points [H, W, 3], normals [H, W, 3], defined [H, W] bool
    """Points and normals (towards the camera) from central differences; undefined at borders, edges and holes."""
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
        good &= (one > 0) & (other > 0) & (np.abs(one + other - 2.0 * center) < most_bend * center)
    defined[middle, middle] = good
    return points, normals, defined


def _seen(
    pose: np.ndarray, references: _References, frame: Frame, rays: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The reference points that the frame sees: index [n], place [n, 3] in the camera, pixel [n, 2], residual [n]."""
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
    image: np.ndarray,  # [H, W, 9] colour, its slope per column, its slope per row
    colors: np.ndarray,  # [n, 3]
    place: np.ndarray,  # [n, 3]
    pixel: np.ndarray,  # [n, 2] column, row; pixel centres at + .5
    camera: PinholeCamera,
) -> tuple[np.ndarray, np.ndarray]:  # rows [3 n, 6], residuals [3 n]
    values = _bilinear(image, pixel - 0.5)
    per_x = values[:, 3:6] * (camera.fx / place[:, 2:])
    per_y = values[:, 6:9] * (camera.fy / place[:, 2:])
    per_z = -(per_x * place[:, :1] + per_y * place[:, 1:2]) / place[:, 2:]
    slopes = np.stack([per_x, per_y, per_z], axis=-1).reshape(-1, 3)
    return _rows(slopes, np.repeat(place, 3, axis=0)), (colors - values[:, :3]).reshape(-1)


def _rows(direction: np.ndarray, place: np.ndarray) -> np.ndarray:  # [n, 3], [n, 3] -> [n, 6]
    """Derivative of direction . (rho + phi x place) by (rho, phi)."""
    return np.concatenate([direction, np.cross(place, direction)], axis=1)


def _robust_weights(residuals: np.ndarray, least: float, huber: float) -> np.ndarray:
    """Huber's weights over the variance; the scale is the median absolute residual's, at least ``least``."""
    scale = max(least, 1.4826 * float(np.median(np.abs(residuals))))
    return np.minimum(1.0, huber * scale / np.maximum(np.abs(residuals), 1e-12)) / scale**2


def _smoothed(frame: Frame, blur_deg: float) -> np.ndarray:  # [H, W, 3] float32 0..1
    """Blurred by an angle: a keyframe with fewer pixels than the frame it is compared with shows as much detail."""
    import cv2

    sigma = blur_deg * np.pi / 180.0 * frame.camera.fx  # pixels
    return cv2.GaussianBlur(frame.rgb.astype(np.float32) / 255.0, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)


def _with_slopes(image: np.ndarray) -> np.ndarray:  # [H, W, 3] -> [H, W, 9]
    per_column, per_row = np.zeros_like(image), np.zeros_like(image)
    per_column[:, 1:-1] = 0.5 * (image[:, 2:] - image[:, :-2])
    per_row[1:-1] = 0.5 * (image[2:] - image[:-2])
    return np.concatenate([image, per_column, per_row], axis=2)


def _bilinear(image: np.ndarray, at: np.ndarray) -> np.ndarray:  # [H, W, c], [n, 2] column, row inside -> [n, c]
    corner = np.floor(at).astype(int)
    share = (at - corner)[:, :, None]
    (column, row), (x, y) = corner.T, (share[:, 0], share[:, 1])
    upper = image[row, column] * (1.0 - x) + image[row, column + 1] * x
    lower = image[row + 1, column] * (1.0 - x) + image[row + 1, column + 1] * x
    return upper * (1.0 - y) + lower * y


def _tangent(motion: np.ndarray) -> np.ndarray:  # [6] (rho, phi)
    """Logarithm of a small rigid motion, to the first order of the rotation (inverse of `se3_exp` up to phi^2 rho)."""
    phi = Rotation.from_matrix(motion[:3, :3]).as_rotvec()
    return np.concatenate([motion[:3, 3] - 0.5 * np.cross(phi, motion[:3, 3]), phi])
