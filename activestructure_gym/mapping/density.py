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

# Tolerances of the test whether two neighbouring pixels are on one surface (`same_surface`), as shares of the depth.
# Each of the two pixels defines a plane together with the next pixel outwards. If the other pixel is within the first
# tolerance of one plane, both are on one surface (8 cm at 4 m, about three sigmas of a Kinect). If it is beyond the
# second tolerance of a reliable plane, they are not. In between, as where wall and floor meet, one plane suffices
# (measured).
_SAME_SURFACE, _OTHER_SURFACE = 0.02, 0.04
# Tolerance with which the plane of three pixels must predict the fourth one to prove one surface alone (measured).
_PROVEN = 0.01
# Metres. Gaps between neighbouring pixels up to the first length are filled where `same_surface` holds. Up to the
# second length, as on a far floor, they are filled where `proven_same_surface` holds. Larger gaps are not filled.
_MAX_GAP_M, _MAX_PROVEN_GAP_M = 0.5, 2.0
_MAX_PARTS = 32  # parts per gap between two pixels, which limits the samples per pixel to about 1000
_LEVELS = 255.0  # largest value of a uint8 colour


class SurfaceSamples(NamedTuple):
    """Hold n surface points of a frame. Points at pixels come first, and interpolated points follow."""

    points: np.ndarray  # [n, 3] float32 metres, camera frame
    pixels: np.ndarray  # [n] int64, flat index of the pixel; of the upper left pixel for an interpolated point
    colors: np.ndarray  # [n, 3] float32 0..1


def wanted_spacing(
    frame: Frame,
    *,
    plain: float,  # metres, wanted spacing on surfaces without texture
    pixels: float,  # wanted spacing in pixels, at texture and edges
    contrast: float,  # smallest difference of a colour channel between neighbouring pixels that counts as texture, 0..1
) -> np.ndarray:  # [H, W] float32 metres
    """Return the wanted spacing of Gaussians per pixel: a surface point should have a mean within this distance."""
    resolved = pixels * frame.depth / np.float32(0.5 * (frame.camera.fx + frame.camera.fy))
    spacing = np.where(_textured(frame.rgb, frame.depth, contrast), np.minimum(resolved, plain), plain)
    return np.ascontiguousarray(spacing, dtype=np.float32)


@kernel
def _textured(
    rgb: np.ndarray,  # [H, W, 3] uint8
    depth: np.ndarray,  # [H, W] float32 metres; 0 = no return
    contrast: float,  # smallest difference of a channel that counts as texture, 0..1
) -> np.ndarray:  # [H, W] bool
    """Return a mask of the pixels that differ from one of their four neighbours in colour or surface."""
    height, width = depth.shape
    least = contrast * _LEVELS
    textured = np.zeros((height, width), np.bool_)
    for row in range(height):
        for column in range(width):
            for down, right in ((0, 1), (1, 0)):
                i, j = row + down, column + right
                if i >= height or j >= width:
                    continue
                if not same_surface(depth, row, column, down, right):
                    textured[row, column] = textured[i, j] = True
                for channel in range(3):
                    # np.int64 and not int(): in compiled code int() of a uint8 is unsigned, and the difference would
                    # wrap around.
                    step = np.int64(rgb[row, column, channel]) - np.int64(rgb[i, j, channel])
                    if abs(step) > least:
                        textured[row, column] = textured[i, j] = True
    return textured


@kernel
def same_surface(depth: np.ndarray, row: int, column: int, down: int, right: int) -> bool:
    """Return whether pixel (row, column) and its neighbour (row + down, column + right) are on one surface.

    1 / depth is linear along a plane, so each pixel and the next one outwards predict the depth of the other pixel. At
    least one prediction must agree. A prediction that is far off counts against the pair if its own two pixels are on
    one plane with the pixel beyond. Otherwise Gaussians in free space would connect a surface to the edge of another
    one.
    """
    agrees = False
    here, there = _depth_at(depth, row, column), _depth_at(depth, row + down, column + right)
    for side in range(2):
        near, target = (here, there) if side == 0 else (there, here)
        i, j = (row - down, column - right) if side == 0 else (row + 2 * down, column + 2 * right)
        beyond = _depth_at(depth, i, j)
        if _on_plane(near, beyond, target, _SAME_SURFACE):
            agrees = True
        if _on_plane(near, beyond, target, _OTHER_SURFACE):
            continue
        i, j = (i - down, j - right) if side == 0 else (i + down, j + right)
        if _on_plane(beyond, _depth_at(depth, i, j), near, _SAME_SURFACE):
            return False
    return agrees


@kernel
def proven_same_surface(depth: np.ndarray, row: int, column: int, down: int, right: int) -> bool:
    """Return whether pixel (row, column) and its neighbour (row + down, column + right) are on one surface for sure.

    As in `same_surface`, each pixel and the next one outwards predict the depth of the other pixel. Either both
    predictions agree, or one agrees within half the tolerance and its plane contains the next pixel outwards as well.
    """
    agree = 0
    for side in range(2):
        i, j, di, dj = (row, column, -down, -right) if side == 0 else (row + down, column + right, down, right)
        near, target = _depth_at(depth, i, j), _depth_at(depth, i - di, j - dj)
        beyond = _depth_at(depth, i + di, j + dj)
        farther = _depth_at(depth, i + 2 * di, j + 2 * dj)
        if _on_plane(near, beyond, target, _PROVEN) and _on_plane(beyond, farther, near, _PROVEN):
            return True
        agree += _on_plane(near, beyond, target, _SAME_SURFACE)
    return agree == 2


@kernel
def _depth_at(depth: np.ndarray, row: int, column: int) -> float:
    """Return the depth of pixel (row, column) in metres; 0 outside the image."""
    height, width = depth.shape
    inside = row >= 0 and column >= 0 and row < height and column < width
    return float(depth[row, column]) if inside else 0.0


@kernel
def _on_plane(near: float, beyond: float, target: float, share: float) -> bool:
    """Return whether three pixels in a line are on one plane: depths ``beyond``, ``near``, ``target`` in this order.

    The depth predicted for the last one may differ by the fraction ``share`` of ``target``. False if a depth is 0 (no
    return).
    """
    if not (near > 0.0 and beyond > 0.0 and target > 0.0):
        return False
    inverse = 2.0 / near - 1.0 / beyond
    return inverse > 0.0 and abs(1.0 / inverse - target) < share * target


def surface_samples(frame: Frame, spacing: np.ndarray) -> SurfaceSamples:
    """Return surface points of a frame that are at most ``spacing`` [H, W] metres apart."""
    points = np.ascontiguousarray(frame.camera.backproject(frame.depth), dtype=np.float32)
    room = 4 * int(np.count_nonzero(frame.depth > 0)) + 64  # the second attempt has room for all samples
    while True:
        arrays = (np.empty((room, 3), np.float32), np.empty(room, np.int64), np.empty((room, 3), np.float32))
        count = _sample(points, np.ascontiguousarray(frame.rgb), frame.depth, spacing, SurfaceSamples(*arrays))
        if count <= room:
            return SurfaceSamples(*(array[:count] for array in arrays))
        room = count


@kernel
def _sample(points, rgb, depth, spacing, into):  # type: ignore[no-untyped-def]
    """Write the surface samples of a frame to arrays; return the number of all samples, including those without room.

    ``points`` [H, W, 3] are camera-frame points in metres, ``rgb`` the image, ``spacing`` [H, W] in metres, and
    ``into`` the `SurfaceSamples` to write.
    """
    height, width = depth.shape
    room, count = len(into.pixels), 0
    scale = np.float32(1.0 / _LEVELS)
    for row in range(height):
        for column in range(width):
            if not depth[row, column] > 0.0:
                continue
            if count < room:
                into.pixels[count] = row * width + column
                for k in range(3):
                    into.points[count, k] = points[row, column, k]
                    into.colors[count, k] = rgb[row, column, k] * scale
            count += 1
    for row in range(height):
        for column in range(width):
            if not depth[row, column] > 0.0:
                continue
            across = _parts(_filled_gap(points, depth, row, column, 0, 1), spacing[row, column])
            along = _parts(_filled_gap(points, depth, row, column, 1, 0), spacing[row, column])
            if across * along == 1:
                continue
            whole = (
                min(across, along) > 1
                and _filled_gap(points, depth, row + 1, column, 0, 1) > 0.0
                and _filled_gap(points, depth, row, column + 1, 1, 0) > 0.0
            )
            below, next_column = min(row + 1, height - 1), min(column + 1, width - 1)
            for i in range(along):
                for j in range(across):
                    if i + j == 0 or (not whole and i * j > 0):
                        continue
                    if count < room:
                        v, u = np.float32(i / along), np.float32(j / across)
                        into.pixels[count] = row * width + column
                        for k in range(3):
                            upper = (
                                points[row, column, k] * (1 - u) + points[row, next_column, k] * u
                                if u > 0
                                else points[row, column, k]
                            )
                            lower = (
                                points[below, column, k] * (1 - u) + points[below, next_column, k] * u
                                if u > 0
                                else points[below, column, k]
                            )
                            into.points[count, k] = upper * (1 - v) + lower * v if v > 0 else upper
                            upper = rgb[row, column, k] * (1 - u) + rgb[row, next_column, k] * u
                            lower = rgb[below, column, k] * (1 - u) + rgb[below, next_column, k] * u
                            into.colors[count, k] = (upper * (1 - v) + lower * v) * scale
                    count += 1
    return count


@kernel
def _filled_gap(points, depth, row, column, down, right):  # type: ignore[no-untyped-def]
    """Return the gap in metres between a pixel and its neighbour; 0 if samples must not fill it.

    The pixels are (row, column) and (row + down, column + right). ``points`` [H, W, 3] are camera-frame points in
    metres, and ``depth`` [H, W] is in metres.
    """
    gap = np.float32(0.0)
    if not same_surface(depth, row, column, down, right):
        return gap
    for k in range(3):
        step = points[row + down, column + right, k] - points[row, column, k]
        gap += step * step
    gap = np.sqrt(gap)
    if gap > _MAX_PROVEN_GAP_M or (gap > _MAX_GAP_M and not proven_same_surface(depth, row, column, down, right)):
        return np.float32(0.0)
    return gap


@kernel
def _parts(gap: float, spacing: float) -> int:
    """Return the number of parts into which samples divide a gap; ``spacing`` is the wanted spacing, both in metres."""
    parts = max(1, min(_MAX_PARTS, int(np.ceil(gap / (np.float32(1.25) * spacing) - np.float32(1e-3)))))
    # If parts are shorter than the spacing, every other sample is redundant. An odd number of parts would then leave
    # two redundant samples in a row.
    return parts + 1 if parts % 2 == 1 and parts > 1 and gap <= parts * spacing else parts


COVERED, SEED, REDUNDANT = 0, 1, 2  # states of a sample: near a mean; becomes a Gaussian; near another seed


def states_of_samples(
    samples: SurfaceSamples,
    spacing: np.ndarray,  # [H, W] metres, wanted spacing
    parameters: np.ndarray,  # [14, capacity] parameters of the map
    count: int,  # number of Gaussians
    frame: Frame,
    *,
    unseen: np.ndarray | None = None,  # [chunks] bool, chunks outside the frame's view
    leaving: np.ndarray | None = None,  # [count] bool, Gaussians to ignore because they will be removed
) -> np.ndarray:  # [n] uint8 `COVERED`, `SEED` or `REDUNDANT`
    """Return the state of each sample.

    A sample becomes a seed if no mean and no other seed is within the wanted spacing. Means with an opacity below 0.5
    do not count. Neither do disks that face away: the other side of a thin wall is another surface.
    """
    pose = frame.world_from_camera
    points = (samples.points.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32)
    view = _FrameView(measured_depth(frame), pose[:3, 3].astype(np.float32), chunks_to_skip(unseen, count))
    leaving = np.zeros(count, dtype=bool) if leaving is None else leaving
    return _choose(points, spacing.ravel()[samples.pixels], parameters, count, leaving, view)


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
def _choose(points, reach, parameters, count, leaving, view):  # type: ignore[no-untyped-def]
    n = len(points)
    state = np.empty(n, np.uint8)
    if n == 0:
        return state
    cell = np.float32(reach.max())
    in_view = _means_in_view(parameters, count, leaving, view, cell)
    # The hash table has linked lists of the points in each cell: first the means of the map, then the chosen samples.
    size = 16
    while size < 2 * (len(in_view) + n):
        size *= 2
    heads, following = np.full(size, -1, np.int32), np.empty(len(in_view) + n, np.int32)
    known = len(in_view)
    for k in range(known):
        i = in_view[k]
        place = bucket(
            int(np.floor(parameters[0, i] / cell)), int(np.floor(parameters[1, i] / cell)),
            int(np.floor(parameters[2, i] / cell)), size,
        )  # fmt: skip
        following[k], heads[place] = heads[place], k
    for s in range(n):
        x, y, z = points[s, 0], points[s, 1], points[s, 2]
        cx, cy, cz = int(np.floor(x / cell)), int(np.floor(y / cell)), int(np.floor(z / cell))
        farthest = reach[s]
        square = farthest * farthest
        state[s] = SEED
        for a in range(int(np.floor((x - farthest) / cell)), int(np.floor((x + farthest) / cell)) + 1):
            for b in range(int(np.floor((y - farthest) / cell)), int(np.floor((y + farthest) / cell)) + 1):
                for c in range(int(np.floor((z - farthest) / cell)), int(np.floor((z + farthest) / cell)) + 1):
                    k = heads[bucket(a, b, c, size)]
                    while k >= 0 and state[s] != COVERED:
                        if k < known:
                            i = in_view[k]
                            dx, dy, dz = parameters[0, i] - x, parameters[1, i] - y, parameters[2, i] - z
                            if dx * dx + dy * dy + dz * dz <= square:
                                state[s] = COVERED
                        else:
                            dx, dy, dz = points[k - known, 0] - x, points[k - known, 1] - y, points[k - known, 2] - z
                            if dx * dx + dy * dy + dz * dz <= square:
                                state[s] = REDUNDANT
                        k = following[k]
                    if state[s] == COVERED:
                        break
                if state[s] == COVERED:
                    break
            if state[s] == COVERED:
                break
        if state[s] == SEED:
            place = bucket(cx, cy, cz, size)
            following[known + s], heads[place] = heads[place], known + s
    return state


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
