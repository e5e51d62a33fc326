"""New Gaussians from one RGB-D frame: where the map lacks them, and how they lie.

A seed is a flat disk in the surface's tangent plane, one per cell of a pixel grid. Against one isotropic ball per pixel
this needs a quarter of the Gaussians for the same image error (docs/notebook/groundwork.md, "The mapper's recipe").
Two things are added to that recipe, which was measured with all views at one distance: disks on slanted surfaces are
stretched, so that their rows leave no gaps, and Gaussians that turn out too coarse when the camera comes closer make
way for finer ones (numbers: `MapperConfig`). SplaTAM's balls are here for the recipe that follows it.
"""

from __future__ import annotations

import numpy as np

from activestructure_gym.geometry import invert_rigid, transform_points
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.geometry.rotations import quaternions
from activestructure_gym.mapping.gaussian_map import COLOR, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, ROWS
from activestructure_gym.mapping.map_passes import MeasuredDepth, larger_in_view


def missing_pixels(
    depth: np.ndarray,  # [H, W] metres, measured; 0 = no return
    rendered_depth: np.ndarray,  # [H, W] accumulated: sum of weight * z
    alpha: np.ndarray,  # [H, W] 0..1
    *,
    covered_alpha: float = 0.5,  # below: nothing of the map stands here
    error_factor: float = 50.0,  # times the median depth error of the image
    error_floor: float = 0.03,  # metres
    normalised: bool = True,
) -> np.ndarray:  # [H, W] bool
    """Pixels that need new Gaussians: the map is transparent there, or all it shows lies behind a measured surface.

    The test against the median error is SplaTAM's; the floor keeps a converged map, whose median error falls below
    a millimetre, from seeding sensor noise. ``normalised=False`` is SplaTAM to the letter: depth as accumulated, and
    the median over all pixels, with an error of 0 where nothing was measured.
    """
    measured = depth > 0
    covered = alpha >= covered_alpha
    if normalised:
        behind = rendered_depth / np.maximum(alpha, 1e-10) - depth  # metres by which the map is too deep
        errors = np.abs(behind[measured & covered])
    else:
        behind = np.where(measured, rendered_depth - depth, 0.0)
        errors = np.abs(behind)
    tolerance = max(error_factor * _median(errors), error_floor) if errors.size else error_floor
    return measured & (~covered | (behind > tolerance))


def _median(values: np.ndarray) -> float:
    """`numpy.median` of one or more finite numbers, without its checks, which take longer."""
    low, high = (values.size - 1) // 2, values.size // 2
    ordered = np.partition(values, (low, high), axis=None)
    return float((ordered[low] + ordered[high]) / 2.0)


def too_coarse(
    parameters: np.ndarray,  # [14, capacity] Gaussians
    frame: Frame,
    *,
    limit: float,  # pixels, largest sigma
    wide: float = np.inf,  # metres, middle sigma: from here on ``limit_wide`` holds as well
    limit_wide: float = np.inf,  # pixels, middle sigma
    spacing: float = 1.0,  # distance of neighbouring seeds in sigmas
    count: int | None = None,  # of the columns, the live ones; None = all
) -> tuple[np.ndarray, np.ndarray]:  # [count] bool, [H, W] bool
    """The Gaussians on the surface in view that appear larger than the limit, and the pixels to seed in their place.

    On the surface means that the depth of the centre agrees with what is measured at its pixel within one sigma. What
    is hidden, outside the image, or without a return stays. The pixels are those that the Gaussians were seeds of: what
    else covers them may be their neighbours' rims.
    """
    camera = frame.camera
    return larger_in_view(
        np.ascontiguousarray(parameters, dtype=np.float32),
        parameters.shape[1] if count is None else count,
        MeasuredDepth(
            np.ascontiguousarray(frame.depth, dtype=np.float32),
            invert_rigid(frame.world_from_camera)[:3].astype(np.float32),
            np.array([camera.fx, camera.fy, camera.cx, camera.cy], dtype=np.float32),
        ),
        float(limit),
        float(wide),
        float(limit_wide),
        float(spacing),
    )


def grid_pixels(
    mask: np.ndarray,  # [H, W] bool
    stride: int,
) -> tuple[np.ndarray, np.ndarray]:  # rows [n], columns [n]
    """The pixels of the seed grid (one per ``stride`` x ``stride`` cell, nearest to its middle) inside the mask.

    Row by row: neighbours in the image stay neighbours in the map, which the rasteriser's caches like.
    """
    phase = stride // 2
    rows, columns = np.nonzero(mask[phase::stride, phase::stride])
    return rows * stride + phase, columns * stride + phase


def surface_steps(
    points: np.ndarray,  # [H, W, 3] camera frame, z = 0 where there is no return
    rows: np.ndarray,  # [n]
    columns: np.ndarray,  # [n]
    *,
    min_cosine: float = 0.05,  # of the angle between normal and line of sight
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # per column [n, 3], per row [n, 3], defined [n] bool
    """Change of the surface point from pixel to pixel: one-sided differences towards the smaller depth jump.

    One side is enough on a plane (exact), and beside a depth edge it is the side that stays on the surface. Undefined
    where a direction has no neighbour with a return, or where the surface would be seen nearly edge-on: that is what
    a depth edge on both sides of a thin object looks like.
    """
    center = points[rows, columns]
    per_column, column_found = _one_sided_difference(points, rows, columns, center, 0, 1)
    per_row, row_found = _one_sided_difference(points, rows, columns, center, 1, 0)
    normals = _cross(per_row, per_column)
    cosine = np.einsum("ij,ij->i", normals, -center)
    least = min_cosine * np.linalg.norm(normals, axis=1) * np.linalg.norm(center, axis=1)
    return per_column, per_row, column_found & row_found & (cosine > 0) & (cosine >= least)


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
    elongation: float = 1.0,  # largest ratio of the in-plane axes, 1 = circles
    opacity: float = 0.9,
    min_cosine: float = 0.05,
) -> np.ndarray:  # [14, n] float32, a block for `GaussianMap.append`
    """One disk per pixel, lying on the surface; a ball where the surface's direction is unknown.

    On a slanted surface neighbouring seeds are further apart along the slope than across it; the disks are stretched
    by the same ratio, up to ``elongation``.
    """
    camera = frame.camera
    points = camera.backproject(frame.depth)
    per_column, per_row, defined = surface_steps(points, rows, columns, min_cosine=min_cosine)
    axes, stretch = _disk_axes(per_column[defined], per_row[defined])
    center = points[rows, columns]
    sigma = footprint * stride * center[:, 2] / (0.5 * (camera.fx + camera.fy))

    block = _balls(frame, rows, columns, center, sigma, opacity)
    if defined.any():
        world_axes = frame.world_from_camera[:3, :3] @ axes
        block[QUATERNION, defined] = quaternions(world_axes).T
    block[7, defined] += np.log(np.minimum(stretch, elongation))
    block[9, defined] += np.log(thickness)
    return block


def seed_balls(
    frame: Frame,
    rows: np.ndarray,  # [n]
    columns: np.ndarray,  # [n]
    *,
    stride: int,  # pixels between neighbouring seeds
    footprint: float = 1.0,  # sigma in units of the seeds' spacing on a wall facing the camera
    opacity: float = 0.5,
) -> np.ndarray:  # [14, n] float32, a block for `GaussianMap.append`
    """One ball per pixel, as SplaTAM seeds them: at stride 1 and footprint 1 its sigma is one pixel, z / f."""
    camera = frame.camera
    center = camera.backproject(frame.depth)[rows, columns]
    sigma = footprint * stride * center[:, 2] / (0.5 * (camera.fx + camera.fy))
    return _balls(frame, rows, columns, center, sigma, opacity)


def _balls(
    frame: Frame,
    rows: np.ndarray,
    columns: np.ndarray,
    center: np.ndarray,  # [n, 3] metres, camera
    sigma: np.ndarray,  # [n] metres
    opacity: float,
) -> np.ndarray:  # [14, n] float32
    block = np.empty((ROWS, len(rows)), dtype=np.float32)
    block[MEAN] = transform_points(frame.world_from_camera, center.astype(np.float64)).T
    block[QUATERNION] = [[1.0], [0.0], [0.0], [0.0]]
    block[LOG_SCALE] = np.log(sigma)
    block[OPACITY_LOGIT] = np.log(opacity / (1.0 - opacity))
    block[COLOR] = frame.rgb[rows, columns].T / 255.0
    return block


def _disk_axes(
    per_column: np.ndarray,  # [n, 3]
    per_row: np.ndarray,  # [n, 3], not parallel to it
) -> tuple[np.ndarray, np.ndarray]:  # axes [n, 3, 3] as columns: long, short, normal; ratio long / short [n]
    """Axes of the ellipse that a circle of pixels becomes on the surface."""
    per_column, per_row = per_column.astype(np.float64), per_row.astype(np.float64)
    # Eigenvalues and first eigenvector of the 2 x 2 matrix of inner products, in closed form.
    a = np.einsum("ij,ij->i", per_column, per_column)
    b = np.einsum("ij,ij->i", per_column, per_row)
    d = np.einsum("ij,ij->i", per_row, per_row)
    mean, spread = 0.5 * (a + d), np.hypot(0.5 * (a - d), b)
    angle = 0.5 * np.arctan2(2.0 * b, a - d)
    long = np.cos(angle)[:, None] * per_column + np.sin(angle)[:, None] * per_row
    long /= np.linalg.norm(long, axis=1, keepdims=True)
    normal = _cross(per_row, per_column)  # y x x = -z: towards the camera
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # mean - spread written as determinant / (mean + spread): no cancellation for long ellipses.
    ratio = (mean + spread) / np.sqrt(np.maximum(a * d - b * b, 1e-30))
    return np.stack([long, _cross(normal, long), normal], axis=-1), ratio


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:  # [n, 3], [n, 3] -> [n, 3]
    """`numpy.cross` without what it takes for arrays of other shapes."""
    result = np.empty_like(a)
    for k in range(3):
        m, n = (k + 1) % 3, (k + 2) % 3
        result[:, k] = a[:, m] * b[:, n] - a[:, n] * b[:, m]
    return result
