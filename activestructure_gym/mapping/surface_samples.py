"""Sample the surfaces of a frame: at its pixels, and between distant pixels of one surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping.surface_links import BELOW, RIGHT, proven_same_surface

# Metres. Gaps between neighbouring pixels up to the first length are filled where `surface_links` joins the pixels. Up
# to the second length, as on a far floor, they are filled where `proven_same_surface` holds. Larger
# gaps are not filled.
_MAX_GAP_M, _MAX_PROVEN_GAP_M = 0.5, 2.0
_MAX_PARTS = 32  # parts per gap between two pixels, which limits the samples per pixel to about 1000
_LEVELS = 255.0  # largest value of a uint8 colour


class SurfaceSamples(NamedTuple):
    """Hold n surface points of a frame."""

    points: np.ndarray  # [n, 3] float32 metres, camera frame
    pixels: np.ndarray  # [n] int64, flat index of the pixel; of the upper left pixel for an interpolated point
    colors: np.ndarray  # [n, 3] float32 0..1


def samples_at(frame: Frame, pixels: np.ndarray) -> SurfaceSamples:
    """Return the surface points at pixels (flat indices [n]) of a frame."""
    rows, columns = np.divmod(pixels, frame.camera.width)
    colors = frame.rgb.reshape(-1, 3)[pixels] * np.float32(1.0 / _LEVELS)
    return SurfaceSamples(points_at(frame, rows, columns), pixels, colors)


def points_at(frame: Frame, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:  # [n, 3] metres, camera frame
    """Return the camera-frame points of the pixels (rows [n], columns [n]), as `PinholeCamera.backproject` does."""
    across, down = pixel_slopes(frame.camera)
    depth = frame.depth[rows, columns]
    return np.stack([across[columns] * depth, down[rows] * depth, depth], axis=-1)


def pixel_slopes(camera: PinholeCamera) -> tuple[np.ndarray, np.ndarray]:  # [W] of the columns, [H] of the rows
    """Return x and y, as float32, of the rays with z = 1 through pixel centres."""
    across = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    down = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    return across.astype(np.float32), down.astype(np.float32)


def samples_between(frame: Frame, links: np.ndarray, spacing: np.ndarray) -> SurfaceSamples:
    """Return interpolated points in the gaps between linked pixels that are wider than ``spacing`` [H, W] metres.

    ``links`` are those of `surface_links`. With the points at pixels, surface points are at most ``spacing`` apart.
    """
    rgb, (across, down) = np.ascontiguousarray(frame.rgb), pixel_slopes(frame.camera)
    room = frame.depth.size  # the second attempt has room for all samples
    while True:
        into = SurfaceSamples(
            np.empty((room, 3), np.float32), np.empty(room, np.int64), np.empty((room, 3), np.float32)
        )
        count = _fill(across, down, rgb, frame.depth, links, spacing, into)
        if count <= room:
            return SurfaceSamples(*(array[:count] for array in into))
        room = count


@kernel
def _fill(across, down, rgb, depth, links, spacing, into):  # type: ignore[no-untyped-def]
    """Write interpolated samples of a frame to arrays; return the number of all, including those without room.

    ``across`` and ``down`` are those of `pixel_slopes`, ``spacing`` [H, W] is in metres, and ``into`` are the
    `SurfaceSamples` to write.
    """
    height, width = depth.shape
    points, pixels, colors = into
    room, count = len(pixels), 0
    scale = np.float32(1.0 / _LEVELS)
    wide = np.zeros(width, np.bool_)  # whether a gap of the pixel exceeds the spacing
    for row in range(height):
        below = min(row + 1, height - 1)
        _mark_wide(across, down[row], down[below], depth[row], depth[below], links[row], spacing[row], wide)
        for column in range(width):
            if not wide[column]:
                continue
            gap_across = _filled_gap(across, down, depth, links, row, column, 0, 1)
            gap_along = _filled_gap(across, down, depth, links, row, column, 1, 0)
            parts_across, parts_along = (
                _parts(gap_across, spacing[row, column]),
                _parts(gap_along, spacing[row, column]),
            )
            if parts_across * parts_along == 1:
                continue
            whole = (
                min(parts_across, parts_along) > 1
                and _filled_gap(across, down, depth, links, row + 1, column, 0, 1) > 0.0
                and _filled_gap(across, down, depth, links, row, column + 1, 1, 0) > 0.0
            )
            beside = min(column + 1, width - 1)
            for i in range(parts_along):
                for j in range(parts_across):
                    if i + j == 0 or (not whole and i * j > 0):
                        continue
                    if count < room:
                        v, u = np.float32(i / parts_along), np.float32(j / parts_across)
                        pixels[count] = row * width + column
                        for k in range(3):
                            upper = _coordinate(across, down, depth, row, column, k)
                            if u > 0:
                                upper = upper * (1 - u) + _coordinate(across, down, depth, row, beside, k) * u
                            if v > 0:
                                lower = _coordinate(across, down, depth, below, column, k)
                                if u > 0:
                                    lower = lower * (1 - u) + _coordinate(across, down, depth, below, beside, k) * u
                                upper = upper * (1 - v) + lower * v
                            points[count, k] = upper
                            upper = rgb[row, column, k] * (1 - u) + rgb[row, beside, k] * u
                            lower = rgb[below, column, k] * (1 - u) + rgb[below, beside, k] * u
                            colors[count, k] = (upper * (1 - v) + lower * v) * scale
                    count += 1
    return count


@kernel
def _mark_wide(across, down, down_below, depth, depth_below, links, spacing, wide):  # type: ignore[no-untyped-def]
    """Write whether the gap between a pixel of a row and its right or lower neighbour is too wide for one part."""
    width = len(depth)
    for i in range(width):
        near, far = depth[i], depth_below[i]
        x, y, z = across[i] * far - across[i] * near, down_below * far - down * near, far - near
        limit = np.float32(1.25) * spacing[i]
        wide[i] = (x * x + y * y + z * z > limit * limit) & (links[i] & BELOW != 0)
    for i in range(width - 1):
        near, far = depth[i], depth[i + 1]
        x, y, z = across[i + 1] * far - across[i] * near, down * far - down * near, far - near
        limit = np.float32(1.25) * spacing[i]
        wide[i] |= (x * x + y * y + z * z > limit * limit) & (links[i] & RIGHT != 0)


@kernel
def _coordinate(across, down, depth, row, column, axis):  # type: ignore[no-untyped-def]
    """Return a coordinate of the camera-frame point of a pixel in metres, as float32."""
    z = depth[row, column]
    return across[column] * z if axis == 0 else (down[row] * z if axis == 1 else z)


@kernel
def _filled_gap(across, down, depth, links, row, column, downwards, right):  # type: ignore[no-untyped-def]
    """Return the gap in metres between a pixel and its neighbour; 0 if samples must not fill it.

    The pixels are (row, column) and (row + downwards, column + right).
    """
    gap = np.float32(0.0)
    if links[row, column] & (RIGHT if right else BELOW) == 0:
        return gap
    for k in range(3):
        there = _coordinate(across, down, depth, row + downwards, column + right, k)
        step = there - _coordinate(across, down, depth, row, column, k)
        gap += step * step
    gap = np.sqrt(gap)
    if gap > _MAX_PROVEN_GAP_M or (gap > _MAX_GAP_M and not proven_same_surface(depth, row, column, downwards, right)):
        return np.float32(0.0)
    return gap


@kernel
def _parts(gap: float, spacing: float) -> int:
    """Return the number of parts into which samples divide a gap; ``spacing`` is the wanted spacing, both in metres."""
    parts = max(1, min(_MAX_PARTS, int(np.ceil(gap / (np.float32(1.25) * spacing) - np.float32(1e-3)))))
    # If parts are shorter than the spacing, every other sample is redundant. An odd number of parts would then leave
    # two redundant samples in a row.
    return parts + 1 if parts % 2 == 1 and parts > 1 and gap <= parts * spacing else parts
