"""Create Gaussians from surface samples of a frame, and find missing pixels by SplaTAM's rule.

A seed is a flat disk in the tangent plane of the surface. Compared with one ball per pixel, disks need a quarter of the
Gaussians for the same image error (docs/notebook/lab_notes.md). The default recipe takes its
samples from `activestructure_gym.mapping.density`; the recipe ``splatam`` uses SplaTAM's rule and balls.
"""

from __future__ import annotations

import numpy as np

from activestructure_gym.geometry import transform_points
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.geometry.rotations import quaternions
from activestructure_gym.mapping.gaussian_map import COLOR, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, ROWS
from activestructure_gym.mapping.surface_boundaries import nearest_boundaries
from activestructure_gym.mapping.surface_links import surface_links
from activestructure_gym.mapping.surface_samples import SurfaceSamples, points_at


def missing_pixels(
    depth: np.ndarray,  # [H, W] measured depth in metres, 0 = no return
    rendered_depth: np.ndarray,  # [H, W] accumulated depth: sum of weight times z
    alpha: np.ndarray,  # [H, W] rendered alpha, 0..1
    *,
    covered_alpha: float = 0.5,  # pixels with a lower alpha are missing
    error_factor: float = 50.0,  # depth tolerance as a factor on the median depth error
    error_floor: float = 0.03,  # metres, smallest depth tolerance
    normalised: bool = True,  # whether the rendered depth is divided by alpha
) -> np.ndarray:  # [H, W] bool
    """Return a mask of the pixels that need new Gaussians: the map is transparent, or behind the measured surface.

    The tolerance from the median error is SplaTAM's. In a converged map the median is below 1 mm; the floor then
    prevents seeds from sensor noise. ``normalised=False`` is SplaTAM's exact rule: accumulated depth, and the median
    over all pixels, with error 0 for pixels without a return.
    """
    measured = depth > 0
    covered = alpha >= covered_alpha
    if normalised:
        behind = rendered_depth / np.maximum(alpha, 1e-10) - depth  # metres, error of the rendered depth
        errors = np.abs(behind[measured & covered])
    else:
        behind = np.where(measured, rendered_depth - depth, 0.0)
        errors = np.abs(behind)
    tolerance = max(error_factor * _median(errors), error_floor) if errors.size else error_floor
    return measured & (~covered | (behind > tolerance))


def _median(values: np.ndarray) -> float:
    """Return the median of finite numbers, faster than `numpy.median`, which checks its input."""
    low, high = (values.size - 1) // 2, values.size // 2
    ordered = np.partition(values, (low, high), axis=None)
    return float((ordered[low] + ordered[high]) / 2.0)


def grid_pixels(
    mask: np.ndarray,  # [H, W] bool
    stride: int,  # pixels per side of a grid cell
) -> tuple[np.ndarray, np.ndarray]:  # rows [n], columns [n]
    """Return the pixels of ``mask`` on the seed grid, which has one pixel per cell of ``stride`` x ``stride`` pixels.

    It is the central pixel of the cell. The pixels are in row-major order: neighbours in the image become neighbours in
    the map, which improves cache use.
    """
    down, right = (min(stride // 2, size - 1) for size in mask.shape)  # the last pixel, in an image smaller than a cell
    rows, columns = np.nonzero(mask[down::stride, right::stride])
    return rows * stride + down, columns * stride + right


def surface_steps(
    frame: Frame,
    rows: np.ndarray,  # [n] rows of the pixels
    columns: np.ndarray,  # [n] columns of the pixels
    *,
    min_cosine: float = 0.05,  # least cosine between normal and line of sight
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # step per column [n, 3], step per row [n, 3], defined [n] bool
    """Return how the surface point changes from a pixel to the next column and to the next row, in metres.

    Differences are one-sided, towards the neighbour with the smaller depth difference. This is exact on a plane, and at
    a depth edge it uses the side on the same surface. The result is undefined if a direction has no neighbour with a
    return, or if the surface is viewed at a grazing angle, as between two depth edges of a thin object.
    """
    center = points_at(frame, rows, columns)
    per_column, column_found = _one_sided_difference(frame, rows, columns, center, 0, 1)
    per_row, row_found = _one_sided_difference(frame, rows, columns, center, 1, 0)
    normals = _cross(per_row, per_column)
    cosine = np.einsum("ij,ij->i", normals, -center)
    least = min_cosine * np.linalg.norm(normals, axis=1) * np.linalg.norm(center, axis=1)
    return per_column, per_row, column_found & row_found & (cosine > 0) & (cosine >= least)


def _one_sided_difference(
    frame: Frame, rows: np.ndarray, columns: np.ndarray, center: np.ndarray, row_step: int, column_step: int
) -> tuple[np.ndarray, np.ndarray]:  # difference per pixel step [n, 3], found [n] bool
    height, width = frame.depth.shape
    steps, jumps = [], []
    for sign in (1, -1):
        row, column = rows + sign * row_step, columns + sign * column_step
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        neighbour = points_at(frame, np.where(inside, row, rows), np.where(inside, column, columns))
        steps.append(sign * (neighbour - center))
        jumps.append(np.where(inside & (neighbour[:, 2] > 0), np.abs(neighbour[:, 2] - center[:, 2]), np.inf))
    forward = jumps[0] <= jumps[1]
    return np.where(forward[:, None], steps[0], steps[1]), np.isfinite(np.minimum(jumps[0], jumps[1]))


def seed_disks(
    frame: Frame,
    seeds: SurfaceSamples,
    sigma: np.ndarray,  # [n] metres, in-plane sigma
    *,
    links: np.ndarray | None = None,  # [H, W] uint8 of `surface_links`; None = compute them
    thickness: float = 0.1,  # sigma along the normal / in-plane sigma
    opacity: float = 0.9,  # 0..1
    min_cosine: float = 0.05,  # least cosine between normal and line of sight of a disk
    border_sigmas: float | None = None,  # sigmas from a disk's centre to the boundary of its surface; None = no limit
) -> np.ndarray:  # [14, n] float32, a block for `GaussianMap.append`
    """Return one disk per sample, in the tangent plane of the surface; a ball where the normal is undefined.

    Near a boundary of the surface, the disk is an ellipse that is narrow across the boundary (`nearest_boundaries`).
    """
    block = seed_balls(frame, seeds, sigma, opacity=opacity)
    rows, columns = np.divmod(seeds.pixels, frame.camera.width)
    per_column, per_row, defined = surface_steps(frame, rows, columns, min_cosine=min_cosine)
    if defined.any():
        axes = _disk_axes(per_column[defined], per_row[defined])
        if border_sigmas is not None:
            links = surface_links(frame.depth) if links is None else links
            found = nearest_boundaries(frame, links, seeds.pixels, border_sigmas * sigma)
            near = defined & np.isfinite(found.distance)
            directed, distance = _boundary_axes(
                frame, seeds.pixels[near], found.direction[near], axes[near[defined], :, 2]
            )
            axes[near[defined]] = directed
            narrow = found.distance[near] * distance / border_sigmas
            block[7, near] = np.log(np.clip(narrow, thickness * sigma[near], sigma[near]))
        block[QUATERNION, defined] = quaternions(frame.world_from_camera[:3, :3] @ axes).T
    block[9, defined] += np.log(thickness)
    return block


def seed_balls(
    frame: Frame,
    seeds: SurfaceSamples,
    sigma: np.ndarray,  # [n] metres, sigma
    *,
    opacity: float = 0.5,  # 0..1
) -> np.ndarray:  # [14, n] float32, a block for `GaussianMap.append`
    """Return one ball per sample, with the colour of the sample."""
    block = np.empty((ROWS, len(seeds.pixels)), dtype=np.float32)
    block[MEAN] = transform_points(frame.world_from_camera, seeds.points.astype(np.float64)).T
    block[QUATERNION] = [[1.0], [0.0], [0.0], [0.0]]
    block[LOG_SCALE] = np.log(sigma)
    block[OPACITY_LOGIT] = np.log(opacity / (1.0 - opacity))
    block[COLOR] = seeds.colors.T
    return block


def pixel_samples(frame: Frame, rows: np.ndarray, columns: np.ndarray) -> SurfaceSamples:
    """Return the surface samples at the pixels (rows [n], columns [n]) of a frame."""
    points = points_at(frame, rows, columns)
    pixels = rows * frame.camera.width + columns
    return SurfaceSamples(
        points.astype(np.float32), pixels, frame.rgb[rows, columns].astype(np.float32) / np.float32(255)
    )


def _disk_axes(
    per_column: np.ndarray,  # [n, 3] change of the surface point per column
    per_row: np.ndarray,  # [n, 3] change per row, not parallel to ``per_column``
) -> np.ndarray:  # [n, 3, 3], columns: long axis, short axis, normal
    """Return the axes of the ellipse on the surface whose projection into the image is a circle."""
    per_column, per_row = per_column.astype(np.float64), per_row.astype(np.float64)
    # Angle of the first eigenvector of the 2 x 2 matrix of inner products, in closed form.
    a = np.einsum("ij,ij->i", per_column, per_column)
    b = np.einsum("ij,ij->i", per_column, per_row)
    d = np.einsum("ij,ij->i", per_row, per_row)
    angle = 0.5 * np.arctan2(2.0 * b, a - d)
    long = np.cos(angle)[:, None] * per_column + np.sin(angle)[:, None] * per_row
    long /= np.linalg.norm(long, axis=1, keepdims=True)
    normal = _cross(per_row, per_column)  # y cross x is -z, so the normal points towards the camera
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.stack([long, _cross(normal, long), normal], axis=-1)


def _boundary_axes(
    frame: Frame,
    pixels: np.ndarray,  # [n] flat indices
    direction: np.ndarray,  # [n, 2] unit vectors (column, row) in the image, towards the boundary
    normals: np.ndarray,  # [n, 3] surface normals, camera frame
) -> tuple[np.ndarray, np.ndarray]:  # [n, 3, 3] as columns: across the boundary, along it, normal; [n] metres per pixel
    """Return the axes of disks near a surface boundary, and metres on the surface per pixel across the boundary.

    Axes are across the boundary, along it, and the surface normal.
    """
    camera = frame.camera
    rows, columns = np.divmod(pixels, camera.width)
    ray = np.stack(
        [(columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy, np.ones(len(pixels))], axis=-1
    )
    # The line of the boundary in the image and the camera centre span a plane, which cuts the surface along the
    # boundary.
    line = np.stack([-direction[:, 1] / camera.fx, direction[:, 0] / camera.fy, np.zeros(len(pixels))], axis=-1)
    along = _cross(normals, _cross(ray, line))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = _cross(along, normals)
    moved = across[:, :2] - ray[:, :2] * across[:, 2:]  # pixels per metre, without the factor focal length / depth
    pixels_per_metre = np.abs(moved[:, 0] * direction[:, 0] * camera.fx + moved[:, 1] * direction[:, 1] * camera.fy)
    metres_per_pixel = frame.depth.ravel()[pixels] / np.maximum(pixels_per_metre, 1e-6)
    return np.stack([across, along, normals], axis=-1), metres_per_pixel


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:  # [n, 3], [n, 3] -> [n, 3]
    """Return the cross products of rows, faster than `numpy.cross`, which supports other shapes."""
    result = np.empty_like(a)
    for k in range(3):
        m, n = (k + 1) % 3, (k + 2) % 3
        result[:, k] = a[:, m] * b[:, n] - a[:, n] * b[:, m]
    return result
