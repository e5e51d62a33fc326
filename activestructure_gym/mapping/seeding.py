"""New Gaussians from one RGB-D frame: where the map lacks them, and how they lie.

A seed is a flat disk in the surface's tangent plane, one per cell of a pixel grid. Against one isotropic ball per pixel
this needs a quarter of the Gaussians for the same image error (recipe: own ablation, backbones dossier 5.2 and 5.3).
"""

from __future__ import annotations

import numpy as np

from activestructure_gym.geometry import transform_points
from activestructure_gym.mapping.gaussian_map import COLOR, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, ROWS
from activestructure_gym.sensors.frame import Frame


def missing_pixels(
    depth: np.ndarray,  # [H, W] metres, measured; 0 = no return
    rendered_depth: np.ndarray,  # [H, W] accumulated: sum of weight * z
    alpha: np.ndarray,  # [H, W] 0..1
    *,
    covered_alpha: float = 0.5,  # below: nothing of the map stands here
    error_factor: float = 50.0,  # times the median depth error of the image
    error_floor: float = 0.03,  # metres
) -> np.ndarray:  # [H, W] bool
    """Where the map needs new Gaussians: it is transparent there, or all it shows lies behind a measured surface.

    The test against the median error is SplaTAM's; the floor keeps a converged map, whose median error falls below
    a millimetre, from seeding sensor noise.
    """
    measured = depth > 0
    covered = alpha >= covered_alpha
    behind = rendered_depth / np.maximum(alpha, 1e-10) - depth  # metres by which the map is too deep
    both = measured & covered
    if both.any():
        tolerance = max(error_factor * float(np.median(np.abs(behind[both]))), error_floor)
    else:
        tolerance = error_floor
    return measured & (~covered | (behind > tolerance))


def grid_pixels(
    mask: np.ndarray,  # [H, W] bool
    stride: int,
) -> tuple[np.ndarray, np.ndarray]:  # rows [n], columns [n]
    """The pixels of the seed grid (one per ``stride`` x ``stride`` cell, nearest to its middle) inside the mask."""
    phase = stride // 2
    rows, columns = np.nonzero(mask[phase::stride, phase::stride])
    return rows * stride + phase, columns * stride + phase


def depth_normals(
    points: np.ndarray,  # [H, W, 3] camera frame, z = 0 where there is no return
    rows: np.ndarray,  # [n]
    columns: np.ndarray,  # [n]
    *,
    min_cosine: float = 0.1,  # of the angle between normal and line of sight
) -> tuple[np.ndarray, np.ndarray]:  # normals [n, 3] unit, towards the camera; defined [n] bool
    """Surface normals at some pixels from one-sided differences, each on the side of the smaller depth jump.

    One side is enough on a plane (exact), and beside a depth edge it is the side that stays on the surface. Undefined
    where a direction has no neighbour with a return, or where the surface would be seen nearly edge-on: that is what
    a depth edge on both sides of a thin object looks like.
    """
    center = points[rows, columns]
    along_row, row_found = _one_sided_difference(points, rows, columns, center, 0, 1)
    along_column, column_found = _one_sided_difference(points, rows, columns, center, 1, 0)
    normals = np.cross(along_column, along_row)  # y x x = -z: towards the camera
    length = np.linalg.norm(normals, axis=1)
    normals /= np.maximum(length, 1e-30)[:, None]
    cosine = -np.einsum("ij,ij->i", normals, center) / np.maximum(np.linalg.norm(center, axis=1), 1e-30)
    return normals, row_found & column_found & (length > 1e-12) & (cosine >= min_cosine)


def _one_sided_difference(
    points: np.ndarray, rows: np.ndarray, columns: np.ndarray, center: np.ndarray, row_step: int, column_step: int
) -> tuple[np.ndarray, np.ndarray]:  # difference per pixel step [n, 3], found [n] bool
    height, width = points.shape[:2]
    steps, jumps = [], []
    for sign in (1, -1):
        row, column = rows + sign * row_step, columns + sign * column_step
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        neighbour = points[np.where(inside, row, rows), np.where(inside, column, columns)]
        steps.append(sign * (neighbour - center))
        jumps.append(np.where(inside & (neighbour[:, 2] > 0), np.abs(neighbour[:, 2] - center[:, 2]), np.inf))
    forward = jumps[0] <= jumps[1]
    return np.where(forward[:, None], steps[0], steps[1]), np.isfinite(np.minimum(jumps[0], jumps[1]))


def seed_disks(
    frame: Frame,
    rows: np.ndarray,  # [n]
    columns: np.ndarray,  # [n]
    *,
    stride: int,  # pixels between neighbouring seeds
    footprint: float = 0.6,  # in-plane sigma in units of the seeds' spacing on a wall facing the camera
    thickness: float = 0.1,  # sigma along the normal, as a share of the in-plane sigma
    opacity: float = 0.9,
    min_cosine: float = 0.1,
) -> np.ndarray:  # [14, n] float32, a block for `GaussianMap.append`
    """One disk per pixel, lying on the surface; a ball where the surface's direction is unknown."""
    camera = frame.camera
    points = camera.backproject(frame.depth)
    normals, defined = depth_normals(points, rows, columns, min_cosine=min_cosine)
    center = points[rows, columns]
    sigma = footprint * stride * center[:, 2] / (0.5 * (camera.fx + camera.fy))

    block = np.empty((ROWS, len(rows)), dtype=np.float32)
    block[MEAN] = transform_points(frame.world_from_camera, center.astype(np.float64)).T
    world_normals = normals @ frame.world_from_camera[:3, :3].T
    block[QUATERNION] = np.where(defined, _z_axis_to(world_normals), np.array([[1.0], [0.0], [0.0], [0.0]]))
    block[LOG_SCALE] = np.log(sigma)
    block[9] += np.where(defined, np.log(thickness), 0.0)
    block[OPACITY_LOGIT] = np.log(opacity / (1.0 - opacity))
    block[COLOR] = frame.rgb[rows, columns].T / 255.0
    return block


def _z_axis_to(normals: np.ndarray) -> np.ndarray:  # [n, 3] unit -> [4, n] wxyz
    """Shortest rotation that lays the third axis along the normal or against it (a disk has no front)."""
    # With z >= 0 the two axes are at most 90 degrees apart, so the half-angle form never divides by zero.
    normals = normals * np.where(normals[:, 2:] < 0, -1.0, 1.0)
    x, y, z = normals.T
    quaternion = np.stack([1.0 + z, -y, x, np.zeros_like(x)])
    return quaternion / np.linalg.norm(quaternion, axis=0)
