"""Choose the positions of new Gaussians, with a density that depends on surface and texture and not on pixels.

A frame is converted to surface samples: its pixels, and interpolated points between distant pixels of one surface. A
sample becomes a Gaussian (a seed) if no mean is within the spacing wanted there. So a surface is filled once, from any
distance, and a second frame adds only detail that the first one did not resolve.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry import invert_rigid
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping.map_passes import CHUNK, MeasuredDepth, faces_away
from activestructure_gym.mapping.surface_links import BELOW, RIGHT
from activestructure_gym.mapping.surface_samples import SurfaceSamples, pixel_slopes

_LEVELS = 255.0  # largest value of a uint8 colour


def wanted_spacing(
    frame: Frame,
    links: np.ndarray,  # [H, W] uint8 of `surface_links`
    *,
    plain: float,  # metres, wanted spacing on surfaces without texture
    pixels: float,  # wanted spacing in pixels, at texture and edges
    contrast: float,  # smallest difference of a colour channel between neighbouring pixels that counts as texture, 0..1
) -> np.ndarray:  # [H, W] float32 metres
    """Return the wanted spacing of Gaussians per pixel: a surface point should have a mean within this distance.

    A pixel has texture if it differs from one of its four neighbours in colour or surface.
    """
    levels = np.ascontiguousarray(frame.rgb).reshape(frame.rgb.shape[0], -1)
    focal = np.float32(0.5 * (frame.camera.fx + frame.camera.fy))
    contrast = min(int(contrast * _LEVELS), int(_LEVELS))
    return _spacing(levels, frame.depth, links, contrast, np.float32(pixels), focal, np.float32(plain))


@kernel
def _spacing(levels, depth, links, contrast, pixels, focal, plain):  # type: ignore[no-untyped-def]
    """Return the wanted spacing; ``levels`` [H, 3 W] are colours, and larger steps than ``contrast`` are texture."""
    height, width = depth.shape
    spacing = np.empty((height, width), np.float32)
    steps = np.zeros(3 * width, np.bool_)
    beside = np.zeros(width + 1, np.bool_)  # whether column c - 1 differs from column c
    above, below = np.zeros(width, np.bool_), np.zeros(width, np.bool_)
    for row in range(height):
        here = levels[row]
        for i in range(3 * width - 3):
            steps[i] = abs(np.int16(here[i]) - np.int16(here[i + 3])) > contrast
        for column in range(width - 1):
            step = steps[3 * column] | steps[3 * column + 1] | steps[3 * column + 2]
            beside[column + 1] = step | (links[row, column] & RIGHT == 0)
        above, below = below, above
        if row + 1 < height:
            there = levels[row + 1]
            for i in range(3 * width):
                steps[i] = abs(np.int16(here[i]) - np.int16(there[i])) > contrast
            for column in range(width):
                step = steps[3 * column] | steps[3 * column + 1] | steps[3 * column + 2]
                below[column] = step | (links[row, column] & BELOW == 0)
        else:
            below[:] = False
        for column in range(width):
            textured = beside[column] | beside[column + 1] | above[column] | below[column]
            resolved = min(pixels * depth[row, column] / focal, plain)
            spacing[row, column] = resolved if textured else plain
    return spacing


COVERED, SEED, REDUNDANT, NO_RETURN = 0, 1, 2, 3  # near a mean; becomes a Gaussian; near another seed; no surface


def states_of_samples(
    frame: Frame,
    between: SurfaceSamples,  # n samples of `samples_between`
    spacing: np.ndarray,  # [H, W] metres, wanted spacing
    parameters: np.ndarray,  # [14, capacity] parameters of the map
    count: int,  # number of Gaussians
    *,
    unseen: np.ndarray | None = None,  # [chunks] bool, chunks outside the frame's view
    leaving: np.ndarray | None = None,  # [count] bool, Gaussians to ignore because they will be removed
) -> np.ndarray:  # [H * W + n] uint8 `COVERED`, `SEED`, `REDUNDANT` or `NO_RETURN`
    """Return the state of the surface point of each pixel, and then of each sample between pixels.

    A sample becomes a seed if no mean and no other seed is within the wanted spacing. Means with an opacity below 0.5
    do not count. Neither do disks that face away: the other side of a thin wall is another surface.
    """
    pose = np.ascontiguousarray(frame.world_from_camera, dtype=np.float64)
    points = (between.points.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32)
    view = _FrameView(measured_depth(frame), pose[:3, 3].astype(np.float32), chunks_to_skip(unseen, count))
    leaving = np.zeros(count, dtype=bool) if leaving is None else leaving
    samples = _Samples(*pixel_slopes(frame.camera), pose, spacing, points, spacing.ravel()[between.pixels])
    return _choose(samples, parameters, count, leaving, view)


class _Samples(NamedTuple):
    """Hold the surface points of pixels and the n samples between pixels, with their wanted spacing."""

    across: np.ndarray  # [W] x / z of the ray of each column
    down: np.ndarray  # [H] y / z of the ray of each row
    pose: np.ndarray  # [4, 4] world_from_camera
    spacing: np.ndarray  # [H, W] metres
    between: np.ndarray  # [n, 3] float32 metres, world
    reach: np.ndarray  # [n] metres, spacing of the samples between pixels


class _Grid(NamedTuple):
    """Hold a hash table of cubic cells, whose buckets are linked lists of points."""

    points: np.ndarray  # [room, 3] float32 metres
    heads: np.ndarray  # [size] int32, last point of each bucket; -1 = none
    following: np.ndarray  # [room] int32, next point in the bucket; -1 = none
    cell: float  # metres


class _FrameView(NamedTuple):
    """Hold depth, pose and camera of a frame as one kernel argument."""

    measured: MeasuredDepth
    eye: np.ndarray  # [3] float32 metres, camera position in the world
    unseen: np.ndarray  # [chunks] bool, chunks of the map outside the view


def chunks_to_skip(unseen: np.ndarray | None, count: int) -> np.ndarray:  # [chunks] bool
    """Return the mask ``unseen``; if it is None, return a mask that skips no chunk of a map of ``count`` Gaussians."""
    return np.zeros(-(-count // CHUNK), dtype=bool) if unseen is None else unseen


def measured_depth(frame: Frame) -> MeasuredDepth:
    """Return depth, pose and camera of a frame as a kernel argument of `map_passes`."""
    camera = frame.camera
    return MeasuredDepth(
        np.ascontiguousarray(frame.depth, dtype=np.float32),
        invert_rigid(frame.world_from_camera)[:3].astype(np.float32),
        np.array([camera.fx, camera.fy, camera.cx, camera.cy], dtype=np.float32),
    )


@kernel
def _choose(samples, parameters, count, leaving, view):  # type: ignore[no-untyped-def]
    """Return the states of all ``samples``, those of pixels first; ``view`` is a `_FrameView`."""
    across, down, pose, spacing, between, reach = samples
    depth = view.measured.depth
    height, width = depth.shape
    state = np.full(height * width + len(between), NO_RETURN, np.uint8)
    cell = np.float32(0.0)
    for row in range(height):
        for column in range(width):
            if depth[row, column] > 0.0:
                cell = max(cell, spacing[row, column])
    if cell == 0.0:
        return state
    in_view = _means_in_view(parameters, count, leaving, view, cell)
    means, seeds = _new_grid(len(in_view), len(in_view), cell), _new_grid(len(state), len(state) // 8, cell)
    for k in range(len(in_view)):
        i = in_view[k]
        _insert(means, k, parameters[0, i], parameters[1, i], parameters[2, i])
    chosen = 0
    # A mean or seed that is near a pixel is often near the next pixel and the one below, too.
    mean, seed = -1, -1
    no_means, no_seeds = np.array([1, 0, 1, 0, 1, 0]), np.array([1, 0, 1, 0, 1, 0])  # the `empty` of `_near`
    mean_above, seed_above = np.full(width, -1, np.int32), np.full(width, -1, np.int32)
    points = np.empty((width, 3), np.float32)
    for first in range(0, len(state), width):
        row, length = first // width, min(width, len(state) - first)
        if row < height:
            _to_world(across, down[row], depth[row], pose, points)
        for column in range(length):
            s, k = first + column, first + column - height * width
            if k >= 0:
                x, y, z, farthest = between[k, 0], between[k, 1], between[k, 2], reach[k]
            elif depth[row, column] > 0.0:
                x, y, z, farthest = points[column, 0], points[column, 1], points[column, 2], spacing[row, column]
            else:
                continue
            square = farthest * farthest
            if not (mean >= 0 and _squared_distance(means.points, mean, x, y, z) <= square):
                mean = mean_above[column]
                if not (mean >= 0 and _squared_distance(means.points, mean, x, y, z) <= square):
                    mean = _near(means, no_means, x, y, z, farthest)
            mean_above[column] = mean
            if mean >= 0:
                state[s] = COVERED
                continue
            state[s] = REDUNDANT
            if not (seed >= 0 and _squared_distance(seeds.points, seed, x, y, z) <= square):
                seed = seed_above[column]
                if not (seed >= 0 and _squared_distance(seeds.points, seed, x, y, z) <= square):
                    seed = _near(seeds, no_seeds, x, y, z, farthest)
                    if seed < 0:
                        state[s], seed = SEED, chosen
                        _insert(seeds, seed, x, y, z)
                        chosen += 1
                        no_seeds[1] = no_seeds[0] - 1
            seed_above[column] = seed
    return state


@kernel
def _to_world(across, down, depth, pose, points):  # type: ignore[no-untyped-def]
    """Write the world points [W, 3] in metres of a row of pixels."""
    for i in range(len(depth)):
        x, y, z = np.float64(across[i] * depth[i]), np.float64(down * depth[i]), np.float64(depth[i])
        for axis in range(3):
            points[i, axis] = pose[axis, 0] * x + pose[axis, 1] * y + pose[axis, 2] * z + pose[axis, 3]


@kernel
def _new_grid(room, expected, cell):  # type: ignore[no-untyped-def]
    """Return a `_Grid` for up to ``room`` points, with as many buckets as suit the number of points ``expected``."""
    size = 16
    while size < 2 * expected:
        size *= 2
    return _Grid(np.empty((room, 3), np.float32), np.full(size, -1, np.int32), np.empty(room, np.int32), cell)


@kernel
def _insert(grid, k, x, y, z):  # type: ignore[no-untyped-def]
    """Write point ``k`` and enter it into its bucket."""
    points, heads, following, cell = grid
    place = bucket(int(np.floor(x / cell)), int(np.floor(y / cell)), int(np.floor(z / cell)), len(heads))
    points[k, 0], points[k, 1], points[k, 2] = x, y, z
    following[k], heads[place] = heads[place], k


@kernel
def _near(grid, empty, x, y, z, farthest):  # type: ignore[no-untyped-def]
    """Return the index of a point within ``farthest`` metres of (x, y, z), -1 for none.

    ``empty`` [6] holds the first and last cell along each axis of a search that met no point. A search within these
    cells ends at once, and a search without points is stored.
    """
    points, heads, following, cell = grid
    square = farthest * farthest
    a0, a1 = int(np.floor((x - farthest) / cell)), int(np.floor((x + farthest) / cell))
    b0, b1 = int(np.floor((y - farthest) / cell)), int(np.floor((y + farthest) / cell))
    c0, c1 = int(np.floor((z - farthest) / cell)), int(np.floor((z + farthest) / cell))
    if a0 >= empty[0] and a1 <= empty[1] and b0 >= empty[2] and b1 <= empty[3] and c0 >= empty[4] and c1 <= empty[5]:
        return -1
    found = False
    for a in range(a0, a1 + 1):
        for b in range(b0, b1 + 1):
            for c in range(c0, c1 + 1):
                k = heads[bucket(a, b, c, len(heads))]
                while k >= 0:
                    found = True
                    if _squared_distance(points, k, x, y, z) <= square:
                        return k
                    k = following[k]
    if not found:
        empty[0], empty[1], empty[2], empty[3], empty[4], empty[5] = a0, a1, b0, b1, c0, c1
    return -1


@kernel
def _squared_distance(points, k, x, y, z):  # type: ignore[no-untyped-def]
    dx, dy, dz = points[k, 0] - x, points[k, 1] - y, points[k, 2] - z
    return dx * dx + dy * dy + dz * dz


@kernel
def bucket(a: int, b: int, c: int, size: int) -> int:
    """Return the bucket of grid cell (a, b, c) in a hash table with ``size`` buckets, a power of 2."""
    return ((a * 73856093) ^ (b * 19349663) ^ (c * 83492791)) & (size - 1)


@kernel
def _means_in_view(parameters, count, leaving, view, margin):  # type: ignore[no-untyped-def]
    """Return the columns of Gaussians that are opaque, face the camera and have a mean in view.

    A mean counts as in view up to ``margin`` metres outside the view frustum. ``leaving`` [count] marks Gaussians to
    leave out, and ``view`` is a `_FrameView`.
    """
    (depth, m, intrinsics), eye, unseen = view
    height, width = depth.shape
    far = depth.max() + margin
    # Largest distance of such a mean from a side of the image, in metres times focal length in pixels.
    margin_x = margin * np.hypot(intrinsics[0], max(intrinsics[2], width - intrinsics[2]))
    margin_y = margin * np.hypot(intrinsics[1], max(intrinsics[3], height - intrinsics[3]))
    found, at = np.empty(count, np.int32), 0
    for chunk in range(len(unseen)):
        if unseen[chunk]:
            continue
        for i in range(chunk * CHUNK, min(count, (chunk + 1) * CHUNK)):
            a, b, c = parameters[0, i], parameters[1, i], parameters[2, i]
            z = m[2, 0] * a + m[2, 1] * b + m[2, 2] * c + m[2, 3]
            if not (z > -margin and z < far) or parameters[10, i] < 0.0 or leaving[i]:
                continue
            x = intrinsics[0] * (m[0, 0] * a + m[0, 1] * b + m[0, 2] * c + m[0, 3])
            y = intrinsics[1] * (m[1, 0] * a + m[1, 1] * b + m[1, 2] * c + m[1, 3])
            if (
                x < -intrinsics[2] * z - margin_x
                or x > (width - intrinsics[2]) * z + margin_x
                or y < -intrinsics[3] * z - margin_y
                or y > (height - intrinsics[3]) * z + margin_y
            ):
                continue
            if faces_away(parameters, i, eye[0], eye[1], eye[2]):
                continue
            found[at] = i
            at += 1
    return found[:at]
