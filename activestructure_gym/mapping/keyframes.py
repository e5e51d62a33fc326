"""Store the keyframes of a map, and select keyframes for the optimiser steps."""

from __future__ import annotations

import numpy as np

from activestructure_gym.geometry import PinholeCamera, invert_rigid
from activestructure_gym.geometry.frame import Frame

# Number of keyframes tested for overlap at once; the intermediate array fits into the processor's cache.
_CHUNK = 16


class KeyframeStore:
    """Hold all keyframes, with the statistics by which they are selected.

    A frame uses 7 bytes per pixel (uint8 colour, float32 depth). ``psnr`` is the last measured PSNR of each keyframe.
    ``new_share`` is the share of its pixels that the map did not cover when it was added.
    """

    def __init__(self, *, border_share: float) -> None:
        self.frames: list[Frame] = []
        self.psnr: list[float] = []  # [T] dB
        self.new_share: list[float] = []  # [T] 0..1
        self._border_share = border_share
        self._sides: list[np.ndarray] = []  # [4, 4] per keyframe, see `viewing_sides`; computed at the first use
        self._measured: list[int] = []  # per keyframe, number of its last PSNR measurement; -1 if there was none
        self._measurements = 0

    def __len__(self) -> int:
        return len(self.frames)

    def append(self, frame: Frame, *, new_share: float) -> int:
        """Store a copy of a frame and return its index. A copy is needed because sensors can reuse their arrays."""
        stored = Frame(
            rgb=np.array(frame.rgb, dtype=np.uint8, order="C"),
            depth=np.array(frame.depth, dtype=np.float32, order="C"),
            world_from_camera=np.array(frame.world_from_camera, dtype=np.float64),
            camera=frame.camera,
        )
        self.frames.append(stored)
        self.psnr.append(0.0)
        self._measured.append(-1)
        self.new_share.append(new_share)
        return len(self.frames) - 1

    def overlapping(
        self,
        index: int,
        rng: np.random.Generator,
        *,
        pixels: int,  # number of pixels with a depth return that are drawn
        limit: int,  # largest number of keyframes returned
    ) -> list[int]:
        """Return at most ``limit`` other keyframes, drawn uniformly from the keyframes that overlap with ``index``.

        Two keyframes overlap if a surface point of one projects into the image of the other; occlusion is not tested.
        This is SplaTAM's rule without its ranking by overlap, which has no effect before a random choice.
        """
        frame = self.frames[index]
        measured = np.flatnonzero(frame.depth)
        order = rng.permutation(len(self.frames))
        if not len(measured) or limit < 1:
            return []
        drawn = measured[rng.integers(len(measured), size=pixels)]
        points = np.ones((4, len(drawn)), dtype=np.float32)
        points[:3] = _world_points(frame, drawn).T
        found: list[int] = []
        # Keyframes are tested in random order until enough are found. A keyframe is skipped if the bounding sphere of
        # the points is outside one side of its image.
        order = order[(order != index) & self._may_see(points)[order]]
        for start in range(0, len(order), _CHUNK):
            chunk = order[start : start + _CHUNK]
            sides = np.concatenate([self._sides[k] for k in chunk])
            inside = (sides @ points).reshape(len(chunk), 4, -1).min(axis=1) > 0
            found += [int(k) for k in chunk[inside.any(axis=1)]]
            if len(found) >= limit:
                break
        return found[:limit]

    def _may_see(self, points: np.ndarray) -> np.ndarray:  # [4, N] homogeneous -> [T] bool
        """Return False for each keyframe that certainly sees none of the points."""
        for later in self.frames[len(self._sides) :]:
            self._sides.append(viewing_sides(later.camera, later.world_from_camera, border_share=self._border_share))
        middle = 0.5 * (points.min(axis=1) + points.max(axis=1))
        radius = np.linalg.norm(points - middle[:, None], axis=0).max() * 1.001
        sides = np.stack(self._sides)  # [T, 4, 4]
        return (sides @ middle + radius * np.linalg.norm(sides[..., :3], axis=-1) > 0).all(axis=1)

    def record_psnr(self, index: int, psnr: float) -> None:
        """Set the PSNR of keyframe ``index`` to ``psnr`` dB, as its newest measurement."""
        self.psnr[index] = psnr
        self._measured[index] = self._measurements
        self._measurements += 1

    def stalest(self, count: int) -> list[int]:
        """Return the ``count`` keyframes with the oldest PSNR measurement; unmeasured ones come first."""
        order = np.argsort(np.array(self._measured, dtype=np.int64), kind="stable")
        return [int(index) for index in order[: max(0, count)]]

    def to_measure(self, *, oldest: int, count: int) -> list[int]:
        """Return the ``count`` keyframes to measure: ``oldest`` of them by `stalest`, the others by lowest PSNR."""
        first = self.stalest(min(oldest, count))
        worst = [int(index) for index in np.argsort(self.psnr, kind="stable") if index not in first]
        return first + worst[: max(0, count - len(first))]

    def poor(self, *, psnr_threshold: float, new_share_threshold: float) -> list[int]:
        """Return the keyframes with a PSNR below a threshold (dB) or a share of new pixels above a threshold.

        These are ActiveGAMER's global keyframes. There, new pixels are those without any rendered depth.
        """
        return [
            k
            for k in range(len(self.frames))
            if self.psnr[k] < psnr_threshold or self.new_share[k] > new_share_threshold
        ]


def viewing_sides(
    camera: PinholeCamera,
    world_from_camera: np.ndarray,  # [4, 4]
    *,
    border_share: float = 0.0,  # share of the image width ignored at each border
) -> np.ndarray:  # [4, 4] float32
    """Return the planes of the four image sides: a world point (x, y, z, 1) is in view if all products are above 0.

    A point inside both the left and the right side has a depth above 0.
    """
    border = min(border_share * camera.width, 0.49 * min(camera.width, camera.height))
    sides = np.array(
        [
            [camera.fx, 0.0, camera.cx - border, 0.0],
            [-camera.fx, 0.0, camera.width - border - camera.cx, 0.0],
            [0.0, camera.fy, camera.cy - border, 0.0],
            [0.0, -camera.fy, camera.height - border - camera.cy, 0.0],
        ]
    )
    return (sides @ invert_rigid(world_from_camera)).astype(np.float32)


def draw_views(
    iterations: int,
    local: list[int],  # keyframe indices; the first one is the current frame
    remote: list[int],  # keyframe indices
    rng: np.random.Generator,
) -> list[int]:
    """Return the keyframe of each iteration: the first half is drawn from ``local``, the second from ``remote``.

    Without ``remote`` keyframes all are drawn from ``local``. The first iteration uses ``local[0]``, the current frame,
    since only this frame has seen its new Gaussians.
    """
    half = iterations if not remote else (iterations + 1) // 2
    views = [local[k] for k in rng.integers(len(local), size=half)] if local else []
    if views:
        views[0] = local[0]
    if half < iterations:
        views += [remote[k] for k in rng.integers(len(remote), size=iterations - half)]
    return views


def _world_points(frame: Frame, pixels: np.ndarray) -> np.ndarray:  # flat indices [n] -> [n, 3]
    camera = frame.camera
    rows, columns = np.divmod(pixels, camera.width)
    depth = frame.depth.ravel()[pixels].astype(np.float64)
    x = (columns + 0.5 - camera.cx) / camera.fx * depth
    y = (rows + 0.5 - camera.cy) / camera.fy * depth
    points = np.stack([x, y, depth], axis=1)
    return points @ frame.world_from_camera[:3, :3].T + frame.world_from_camera[:3, 3]
