"""Find the first hits of the rays of a whole image by drawing the triangles of a mesh into it.

The rays of a pinhole camera have one origin, so the three edges of a triangle and its inverse depth are linear in the
image. A row of a triangle is an interval of samples, and drawing it costs a comparison per sample. This is 5 to 10
times as fast as casting a ray per sample if triangles cover several samples. Of several faces in one plane,
the one that `RayCaster.cast` hits with ``fronts`` is drawn.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.camera import Lens
from activestructure_gym.scenes.rays import Hits
from activestructure_gym.scenes.traversal import BEHIND

_NEAREST = 1e-6  # metres; a triangle with a nearer vertex may cover the whole image


class Triangles(NamedTuple):
    """Hold the m triangles that are at least partly in the image of a camera."""

    face: np.ndarray  # [m] int32, index of the triangle in the mesh
    # [m, 4, 3] float64. Factors of (column, row, 1) in pixels. The first three linear functions are at least 0 on the
    # same side of an edge as the triangle, in the order of the opposite vertices. The fourth one is the inverse depth
    # in 1 / metres. The barycentric coordinates are the first three divided by their sum.
    planes: np.ndarray
    box: np.ndarray  # [m, 4] float32 pixels: smallest and largest column, smallest and largest row
    weight: np.ndarray  # [m] float32, factor of the inverse depth as it is compared: 1, or 1 / `BEHIND` for a back


def triangles_in_image(
    vertices: np.ndarray,  # [V, 3] float32 metres, world
    faces: np.ndarray,  # [F, 3] int32
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [4, 4]
) -> Triangles:
    """Return the triangles of a mesh that a camera may see; both sides of a triangle count."""
    projected = _project(vertices, np.array(world_from_camera, np.float64), camera.lens)
    count = len(faces)  # only the used part of the arrays takes memory
    into = Triangles(
        np.empty(count, np.int32),
        np.empty((count, 4, 3)),
        np.empty((count, 4), np.float32),
        np.empty(count, np.float32),
    )
    count = _prepare(faces, projected, camera.width, camera.height, *into)
    return Triangles(*(array[:count] for array in into))


@kernel
def _project(vertices: np.ndarray, pose: np.ndarray, lens: Lens) -> np.ndarray:  # [V, 3] float64
    """Return column times depth, row times depth, and depth of each vertex, in pixels and metres."""
    fx, fy, cx, cy = lens
    projected, place = np.empty((len(vertices), 3)), np.empty(3)
    for i in range(len(vertices)):
        x, y, z = vertices[i, 0] - pose[0, 3], vertices[i, 1] - pose[1, 3], vertices[i, 2] - pose[2, 3]
        for k in range(3):
            place[k] = pose[0, k] * x + pose[1, k] * y + pose[2, k] * z
        projected[i, 0], projected[i, 1] = fx * place[0] + cx * place[2], fy * place[1] + cy * place[2]
        projected[i, 2] = place[2]
    return projected


@kernel
def _prepare(faces, projected, width, height, face, planes, box, weight):  # type: ignore[no-untyped-def]
    """Write the arrays of `Triangles` and return their number."""
    count = 0
    for triangle in range(len(faces)):
        i, j, k = faces[triangle, 0], faces[triangle, 1], faces[triangle, 2]
        ax, ay, az = projected[i, 0], projected[i, 1], projected[i, 2]
        bx, by, bz = projected[j, 0], projected[j, 1], projected[j, 2]
        cx, cy, cz = projected[k, 0], projected[k, 1], projected[k, 2]
        if (
            (az <= 0.0 and bz <= 0.0 and cz <= 0.0)
            or (ax < 0.0 and bx < 0.0 and cx < 0.0)
            or (ay < 0.0 and by < 0.0 and cy < 0.0)
            or (ax > width * az and bx > width * bz and cx > width * cz)
            or (ay > height * az and by > height * bz and cy > height * cz)
        ):
            continue  # all vertices are behind the camera or beyond one side of the image
        left, right, top, bottom = 0.0, float(width), 0.0, float(height)
        if min(az, bz, cz) > _NEAREST:
            # The margin of 0.01 pixels is larger than all rounding errors.
            left, right = min(ax / az, bx / bz, cx / cz) - 0.01, max(ax / az, bx / bz, cx / cz) + 0.01
            top, bottom = min(ay / az, by / bz, cy / cz) - 0.01, max(ay / az, by / bz, cy / cz) + 0.01
        p = planes[count]
        # Two triangles with a common edge get exactly opposite factors for it, so no sample falls between them.
        p[0, 0], p[0, 1], p[0, 2] = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
        p[1, 0], p[1, 1], p[1, 2] = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
        p[2, 0], p[2, 1], p[2, 2] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        volume = ax * p[0, 0] + ay * p[0, 1] + az * p[0, 2]
        if volume == 0.0:  # without area, or seen exactly from its side
            continue
        for axis in range(3):
            if volume < 0.0:
                p[0, axis], p[1, axis], p[2, axis] = -p[0, axis], -p[1, axis], -p[2, axis]
            p[3, axis] = (p[0, axis] + p[1, axis] + p[2, axis]) / abs(volume)
        box[count, 0], box[count, 1], box[count, 2], box[count, 3] = left, right, top, bottom
        face[count], weight[count] = triangle, 1.0 if volume < 0.0 else 1.0 / BEHIND
        count += 1
    return count


@kernel
def _nearest(planes, box, weight, first_row, last_row, width, samples):  # type: ignore[no-untyped-def]
    """Return the nearest triangle at each sample of the pixels in the rows ``first_row`` to ``last_row``; -1 = none.

    ``planes``, ``box`` and ``weight`` are those of `Triangles`. A pixel has ``samples`` x ``samples`` samples at the
    centres of its parts, so the result is int32 [(last_row - first_row) * samples, width * samples].
    """
    top, bottom, columns = first_row * samples, last_row * samples, width * samples
    nearest = np.full((bottom - top, columns), -1, np.int32)
    inverse = np.zeros((bottom - top, columns), np.float32)  # 1 / depth of the nearest triangle so far
    half, part = np.float32(0.5), np.float32(1.0 / samples)
    across = (np.arange(columns).astype(np.float32) + half) * part  # columns of the samples in pixels
    for t in range(len(planes)):
        if box[t, 3] < first_row or box[t, 2] > last_row:
            continue
        low = max(top, int(np.ceil(max(box[t, 2], np.float32(0.0)) * samples - half)))
        high = min(bottom - 1, int(np.floor(min(box[t, 3], np.float32(last_row)) * samples - half)))
        left = max(0, int(np.ceil(max(box[t, 0], np.float32(0.0)) * samples - half)))
        right = min(columns - 1, int(np.floor(min(box[t, 1], np.float32(width)) * samples - half)))
        if low > high or left > right:
            continue
        p = planes[t]
        a0, b0, c0 = np.float32(p[0, 0]), np.float32(p[0, 1]), np.float32(p[0, 2])
        a1, b1, c1 = np.float32(p[1, 0]), np.float32(p[1, 1]), np.float32(p[1, 2])
        a2, b2, c2 = np.float32(p[2, 0]), np.float32(p[2, 1]), np.float32(p[2, 2])
        w = weight[t]
        slope, down, level = w * np.float32(p[3, 0]), w * np.float32(p[3, 1]), w * np.float32(p[3, 2])
        for row in range(low, high + 1):
            v = (np.float32(row) + half) * part
            d0, d1, d2 = b0 * v + c0, b1 * v + c1, b2 * v + c2
            # Between its edges, a row of the triangle is an interval. Its ends are found by division, one sample too
            # wide, and then by the exact test.
            start = max(_start(a0, d0), max(_start(a1, d1), _start(a2, d2)))
            end = min(-_start(-a0, d0), min(-_start(-a1, d1), -_start(-a2, d2)))
            end = min(end, np.float32(width))
            if not start <= end + half:
                continue
            i = max(left, int(max(start, np.float32(-1.0)) * samples - half))
            j = min(right, int(end * samples - half) + 1)
            while i <= j and not (a0 * across[i] + d0 >= 0 and a1 * across[i] + d1 >= 0 and a2 * across[i] + d2 >= 0):
                i += 1
            while i <= j and not (a0 * across[j] + d0 >= 0 and a1 * across[j] + d1 >= 0 and a2 * across[j] + d2 >= 0):
                j -= 1
            at_row, r = down * v + level, row - top
            for column in range(i, j + 1):
                here = slope * across[column] + at_row
                nearer = here > inverse[r, column]
                inverse[r, column] = here if nearer else inverse[r, column]
                nearest[r, column] = t if nearer else nearest[r, column]
    return nearest


@kernel
def _start(a, d):  # type: ignore[no-untyped-def]
    """Return about the smallest x with a x + d >= 0: infinity if there is none, minus infinity if there is no bound."""
    if a > np.float32(0.0):
        return -d / a
    return np.float32(np.inf) if a == np.float32(0.0) and d < np.float32(0.0) else np.float32(-np.inf)


@kernel
def _hits(nearest, face, planes, first_row, samples):  # type: ignore[no-untyped-def]
    """Return distance, face, u and v of `Hits` at the samples of `_nearest`, pixel by pixel."""
    height, width = nearest.shape[0] // samples, nearest.shape[1] // samples
    distance, hit = np.empty(nearest.size, np.float32), np.empty(nearest.size, np.int32)
    u, v = np.empty(nearest.size, np.float32), np.empty(nearest.size, np.float32)
    ray = 0
    for row in range(height):
        for column in range(width):
            for sub in range(samples * samples):
                i, j = row * samples + sub // samples, column * samples + sub % samples
                t = nearest[i, j]
                x, y = (j + 0.5) / samples, (i + 0.5) / samples + first_row
                if t >= 0:
                    p = planes[t]
                    first = p[0, 0] * x + p[0, 1] * y + p[0, 2]
                    second = p[1, 0] * x + p[1, 1] * y + p[1, 2]
                    third = p[2, 0] * x + p[2, 1] * y + p[2, 2]
                    share = 1.0 / (first + second + third)
                    u[ray], v[ray], hit[ray] = second * share, third * share, face[t]
                    distance[ray] = 1.0 / (p[3, 0] * x + p[3, 1] * y + p[3, 2])
                else:
                    u[ray], v[ray], hit[ray], distance[ray] = 0.0, 0.0, -1, np.inf
                ray += 1
    return distance, hit, u, v


def hits_in_rows(triangles: Triangles, first_row: int, last_row: int, width: int, samples: int) -> Hits:
    """Return the first hits of the rays through the pixels in the rows ``first_row`` to ``last_row`` of an image.

    ``width`` is in pixels. A pixel has ``samples`` x ``samples`` rays through the centres of its parts, one after the
    other.
    """
    nearest = _nearest(triangles.planes, triangles.box, triangles.weight, first_row, last_row, width, samples)
    return Hits(*_hits(nearest, triangles.face, triangles.planes, first_row, samples))
