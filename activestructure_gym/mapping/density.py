"""Where new Gaussians go: their density follows the surface and its texture, not the pixels of the frame.

A frame is turned into samples of the surface it shows: its pixels, and between pixels that are too far apart points of
the surface that joins them. A sample becomes a Gaussian where no mean stands within the spacing wanted there. So a
surface is filled once, from near and from afar, and a second look adds only what the first one could not resolve.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry import invert_rigid
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping.map_passes import CHUNK, MeasuredDepth, shows_its_back

# Two neighbouring pixels show one surface if the plane through one of them and its neighbour on the other side misses
# the second by less than the first share of its depth (8 cm at 4 m, about three sigmas of a Kinect's noise there), and
# two if such a plane misses by more than the second. In between, where walls meet floors, one plane will do (measured).
_SAME_SURFACE, _OTHER_SURFACE = 0.02, 0.04
_MAX_GAP_M = 0.5  # metres between neighbouring pixels that are filled
_MAX_PARTS = 32  # of a gap, so that no frame asks for more than a thousand samples per pixel
_LEVELS = 255.0


class SurfaceSamples(NamedTuple):
    """Points of the surface in one frame; the pixels' own come first."""

    points: np.ndarray  # [n, 3] float32 metres, camera frame
    pixels: np.ndarray  # [n] int64, flat index of the pixel, or of the upper left one of those around
    colors: np.ndarray  # [n, 3] float32 0..1


def wanted_spacing(
    frame: Frame,
    *,
    plain: float,  # metres, where nothing of the surface is seen but its place
    pixels: float,  # where there is texture or an edge: pixels between neighbours
    contrast: float,  # 0..1, difference of a channel between neighbouring pixels above which there is texture
) -> np.ndarray:  # [H, W] float32 metres
    """Distance within which every point of the surface should have a mean."""
    resolved = pixels * frame.depth / np.float32(0.5 * (frame.camera.fx + frame.camera.fy))
    spacing = np.where(_textured(frame.rgb, frame.depth, contrast), np.minimum(resolved, plain), plain)
    return np.ascontiguousarray(spacing, dtype=np.float32)


@kernel
def _textured(
    rgb: np.ndarray,  # [H, W, 3] uint8
    depth: np.ndarray,  # [H, W] float32 metres; 0 = no return
    contrast: float,
) -> np.ndarray:  # [H, W] bool
    """Pixels that differ from one of their four neighbours in colour, or show another surface."""
    height, width = depth.shape
    least = contrast * _LEVELS
    textured = np.zeros((height, width), np.bool_)
    for row in range(height):
        for column in range(width):
            for down, right in ((0, 1), (1, 0)):
                i, j = row + down, column + right
                if i >= height or j >= width:
                    continue
                if not joined(depth, row, column, down, right):
                    textured[row, column] = textured[i, j] = True
                for channel in range(3):
                    # Not int(): compiled, that of a uint8 is unsigned, and so would be their difference.
                    step = np.int64(rgb[row, column, channel]) - np.int64(rgb[i, j, channel])
                    if abs(step) > least:
                        textured[row, column] = textured[i, j] = True
    return textured


@kernel
def joined(depth: np.ndarray, row: int, column: int, down: int, right: int) -> bool:
    """Whether a pixel and the one below or to the right of it show one surface: 1 / z is linear along a plane.

    The plane of one side has to meet the other pixel, and no plane that the other side shows may miss the first one by
    far: two surfaces one of which points at the other's rim would be joined by Gaussians in mid-air.
    """
    agrees = False
    here, there = _seen(depth, row, column), _seen(depth, row + down, column + right)
    for side in range(2):
        near, target = (here, there) if side == 0 else (there, here)
        i, j = (row - down, column - right) if side == 0 else (row + 2 * down, column + 2 * right)
        beyond = _seen(depth, i, j)
        if _on_the_plane(near, beyond, target, _SAME_SURFACE):
            agrees = True
        if _on_the_plane(near, beyond, target, _OTHER_SURFACE):
            continue
        i, j = (i - down, j - right) if side == 0 else (i + down, j + right)
        if _on_the_plane(beyond, _seen(depth, i, j), near, _SAME_SURFACE):
            return False
    return agrees


@kernel
def _seen(depth: np.ndarray, row: int, column: int) -> float:
    """The depth of a pixel; 0 outside the image."""
    height, width = depth.shape
    inside = row >= 0 and column >= 0 and row < height and column < width
    return float(depth[row, column]) if inside else 0.0


@kernel
def _on_the_plane(near: float, beyond: float, target: float, share: float) -> bool:
    """Whether the plane through a pixel and the one beyond it meets the pixel on its other side, all three seen."""
    if not (near > 0.0 and beyond > 0.0 and target > 0.0):
        return False
    inverse = 2.0 / near - 1.0 / beyond
    return inverse > 0.0 and abs(1.0 / inverse - target) < share * target


def surface_samples(frame: Frame, spacing: np.ndarray) -> SurfaceSamples:
    """Points on the surface of a frame, no further apart than ``spacing`` [H, W] metres asks for."""
    points = np.ascontiguousarray(frame.camera.backproject(frame.depth), dtype=np.float32)
    room = 4 * int(np.count_nonzero(frame.depth > 0)) + 64
    while True:
        arrays = (np.empty((room, 3), np.float32), np.empty(room, np.int64), np.empty((room, 3), np.float32))
        count = _sample(points, np.ascontiguousarray(frame.rgb), frame.depth, spacing, SurfaceSamples(*arrays))
        if count <= room:
            return SurfaceSamples(*(array[:count] for array in arrays))
        room = count


@kernel
def _sample(points, rgb, depth, spacing, into):  # type: ignore[no-untyped-def]
    """Writes as many samples as there is room for; returns how many there are."""
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
            rightwards = column + 1 < width and joined(depth, row, column, 0, 1)
            downwards = row + 1 < height and joined(depth, row, column, 1, 0)
            whole = (
                rightwards
                and downwards
                and joined(depth, row + 1, column, 0, 1)
                and joined(depth, row, column + 1, 1, 0)
            )
            across, along = 1, 1
            if rightwards:
                across = _parts(points, row, column, row, column + 1, spacing[row, column])
            if downwards:
                along = _parts(points, row, column, row + 1, column, spacing[row, column])
            if across * along == 1:
                continue
            below, beside = min(row + 1, height - 1), min(column + 1, width - 1)
            for i in range(along):
                for j in range(across):
                    if i + j == 0 or (not whole and i * j > 0):
                        continue
                    if count < room:
                        v, u = np.float32(i / along), np.float32(j / across)
                        into.pixels[count] = row * width + column
                        for k in range(3):
                            upper = (
                                points[row, column, k] * (1 - u) + points[row, beside, k] * u
                                if u > 0
                                else points[row, column, k]
                            )
                            lower = (
                                points[below, column, k] * (1 - u) + points[below, beside, k] * u
                                if u > 0
                                else points[below, column, k]
                            )
                            into.points[count, k] = upper * (1 - v) + lower * v if v > 0 else upper
                            upper = rgb[row, column, k] * (1 - u) + rgb[row, beside, k] * u
                            lower = rgb[below, column, k] * (1 - u) + rgb[below, beside, k] * u
                            into.colors[count, k] = (upper * (1 - v) + lower * v) * scale
                    count += 1
    return count


@kernel
def _parts(points, row, column, i, j, spacing):  # type: ignore[no-untyped-def]
    """Into how many parts the way between two pixels is divided, so that squares of them leave no gap."""
    gap = np.float32(0.0)
    for k in range(3):
        step = points[i, j, k] - points[row, column, k]
        gap += step * step
    gap = np.sqrt(gap)
    if gap > _MAX_GAP_M:
        return 1
    parts = max(1, min(_MAX_PARTS, int(np.ceil(gap / (np.float32(1.25) * spacing) - np.float32(1e-3)))))
    # Of parts within the spacing every other end is spared, so of an odd number two neighbours would be.
    return parts + 1 if parts % 2 == 1 and parts > 1 and gap <= parts * spacing else parts


HELD, WANTED, SPARED = 0, 1, 2  # of a sample: a mean is near, it becomes one, one of the new ones is near


def states_of_samples(
    samples: SurfaceSamples,
    spacing: np.ndarray,  # [H, W] metres
    parameters: np.ndarray,  # [14, capacity] the map's Gaussians
    count: int,
    frame: Frame,
    *,
    unseen: np.ndarray | None = None,  # [chunks] bool, chunks of the map that the frame cannot show
    leaving: np.ndarray | None = None,  # [count] bool, Gaussians that do not count
) -> np.ndarray:  # [n] uint8 `HELD`, `WANTED` or `SPARED`
    """Which samples become Gaussians: those without a mean within the spacing, no two of them nearer to each other.

    A mean is one of an opacity of at least one half whose disk faces the camera: what stands on the other side of a
    thin wall is another surface.
    """
    pose = frame.world_from_camera
    points = (samples.points.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32)
    around = _Around(measured_depth(frame), pose[:3, 3].astype(np.float32), chunks_to_skip(unseen, count))
    leaving = np.zeros(count, dtype=bool) if leaving is None else leaving
    return _choose(points, spacing.ravel()[samples.pixels], parameters, count, leaving, around)


class _Around(NamedTuple):
    """A frame as the kernels read it."""

    measured: MeasuredDepth
    eye: np.ndarray  # [3] float32 metres, world
    unseen: np.ndarray  # [chunks] bool


def chunks_to_skip(unseen: np.ndarray | None, count: int) -> np.ndarray:  # [chunks] bool
    """`MapParts.unseen` as an array even of a map that has no parts: then nothing is skipped."""
    return np.zeros(-(-count // CHUNK), dtype=bool) if unseen is None else unseen


def measured_depth(frame: Frame) -> MeasuredDepth:
    """The depth of a frame with where it was taken from, as the passes over the map take it."""
    camera = frame.camera
    return MeasuredDepth(
        np.ascontiguousarray(frame.depth, dtype=np.float32),
        invert_rigid(frame.world_from_camera)[:3].astype(np.float32),
        np.array([camera.fx, camera.fy, camera.cx, camera.cy], dtype=np.float32),
    )


@kernel
def _choose(points, reach, parameters, count, leaving, around):  # type: ignore[no-untyped-def]
    n = len(points)
    state = np.empty(n, np.uint8)
    if n == 0:
        return state
    cell = np.float32(reach.max())
    at_hand = _means_in_view(parameters, count, leaving, around, cell)
    # A table of cells, each the head of a list: first the map's means, then the samples that are taken.
    size = 16
    while size < 2 * (len(at_hand) + n):
        size *= 2
    heads, following = np.full(size, -1, np.int32), np.empty(len(at_hand) + n, np.int32)
    known = len(at_hand)
    for k in range(known):
        i = at_hand[k]
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
        state[s] = WANTED
        for a in range(int(np.floor((x - farthest) / cell)), int(np.floor((x + farthest) / cell)) + 1):
            for b in range(int(np.floor((y - farthest) / cell)), int(np.floor((y + farthest) / cell)) + 1):
                for c in range(int(np.floor((z - farthest) / cell)), int(np.floor((z + farthest) / cell)) + 1):
                    k = heads[bucket(a, b, c, size)]
                    while k >= 0 and state[s] != HELD:
                        if k < known:
                            i = at_hand[k]
                            dx, dy, dz = parameters[0, i] - x, parameters[1, i] - y, parameters[2, i] - z
                            if dx * dx + dy * dy + dz * dz <= square:
                                state[s] = HELD
                        else:
                            dx, dy, dz = points[k - known, 0] - x, points[k - known, 1] - y, points[k - known, 2] - z
                            if dx * dx + dy * dy + dz * dz <= square:
                                state[s] = SPARED
                        k = following[k]
                    if state[s] == HELD:
                        break
                if state[s] == HELD:
                    break
            if state[s] == HELD:
                break
        if state[s] == WANTED:
            place = bucket(cx, cy, cz, size)
            following[known + s], heads[place] = heads[place], known + s
    return state


@kernel
def bucket(a: int, b: int, c: int, size: int) -> int:
    """Place of a cell in a table with a power of two of them."""
    return ((a * 73856093) ^ (b * 19349663) ^ (c * 83492791)) & (size - 1)


@kernel
def _means_in_view(parameters, count, leaving, around, margin):  # type: ignore[no-untyped-def]
    """Columns of the solid Gaussians that face the camera and whose means lie in its view, with a margin in metres."""
    (depth, m, intrinsics), eye, unseen = around
    height, width = depth.shape
    far = depth.max() + margin
    # A mean `margin` metres off the image's side lies so far beside it at its own depth, times the focal length.
    beside_x = margin * np.hypot(intrinsics[0], max(intrinsics[2], width - intrinsics[2]))
    beside_y = margin * np.hypot(intrinsics[1], max(intrinsics[3], height - intrinsics[3]))
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
                x < -intrinsics[2] * z - beside_x
                or x > (width - intrinsics[2]) * z + beside_x
                or y < -intrinsics[3] * z - beside_y
                or y > (height - intrinsics[3]) * z + beside_y
            ):
                continue
            if shows_its_back(parameters, i, eye[0], eye[1], eye[2]):
                continue
            found[at] = i
            at += 1
    return found[:at]
