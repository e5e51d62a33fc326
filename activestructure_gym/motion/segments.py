"""Represent the executed frames between two decisions, so that they can be replayed frame by frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

# Keyframes per decision, for a trajectory without decisions. The PSNR of keyframes, which the mapper uses, is measured
# again at every decision (own choice).
KEYFRAMES_PER_SEGMENT = 4


@dataclass(frozen=True)
class PathSegment:
    """Hold the frames executed between two decisions."""

    poses: np.ndarray  # [T, 4, 4] world_from_camera, one per frame, without the pose at the beginning
    refine_factors: tuple[int, ...]  # [T] factor on the mapper's iterations at each frame; 0 = no keyframe
    lost: int = 0  # number of frames used without a pose, because of an unreachable view or an invalid row
    stays: int = 0  # number of frames used to optimise the map in place; there are no poses then


def regular_segments(poses: np.ndarray, keyframe_every: int) -> list[PathSegment]:
    """Split a trajectory [T, 4, 4] into segments of four keyframes. Its first pose is the start.

    Every ``keyframe_every``-th frame and the last one are keyframes.
    """
    frames = np.arange(1, len(poses) + 1)  # number of frames used at each pose
    return segments_at(poses, (frames % keyframe_every == 0) | (frames == len(poses)))


def segments_at(poses: np.ndarray, keyframes: np.ndarray) -> list[PathSegment]:
    """Split a trajectory [T, 4, 4] into segments of four keyframes. Its first pose is the start.

    ``keyframes`` [T] is True at poses to map; the first pose is always mapped.
    """
    mapped = keyframes[1:]
    ends = np.flatnonzero(mapped)[KEYFRAMES_PER_SEGMENT - 1 :: KEYFRAMES_PER_SEGMENT] + 1
    segments = []
    for begin, end in zip([0, *ends], [*ends, len(mapped)]):
        if begin < end:
            factors = tuple(int(keyframe) for keyframe in mapped[begin:end])
            segments.append(PathSegment(poses[1 + begin : 1 + end], factors))
    return segments


def recorded_segments(arrays: Mapping[str, np.ndarray]) -> list[PathSegment]:
    """Return the segments of a run's ``trajectory.npz``; raise ValueError if its arrays are inconsistent.

    ``legs`` [D, 3] holds the state at the end of each decision: number of poses executed, number of frames used, and 1
    if the decision was to optimise in place. ``keyframe_rounds`` [K] holds the iteration factor of each of
    ``keyframes`` [K].
    """
    poses, table = arrays["world_from_camera"], np.asarray(arrays["legs"])
    keyframes, factors = np.asarray(arrays["keyframes"]), np.asarray(arrays["keyframe_rounds"])
    if table.ndim != 2 or table.shape[1] != 3 or table.dtype.kind not in "iu" or factors.dtype.kind not in "iu":
        raise ValueError(f"legs must be whole numbers [D, 3], got {table.dtype} {table.shape}")
    table = table.astype(np.int64)  # signed, since unsigned differences would wrap or become floats
    if keyframes.ndim != 1 or keyframes.dtype.kind not in "iu" or (keyframes < 0).any():
        raise ValueError(f"keyframes must be whole numbers [K] from 0 on, got {keyframes.dtype} {keyframes.shape}")
    if factors.shape != keyframes.shape or (factors < 0).any() or (factors > 1000).any():
        raise ValueError(f"keyframe_rounds must have a number from 0 to 1000 for each of {len(keyframes)} keyframes")
    before = np.vstack([[[1, 1, 0]], table])[:-1]
    executed, paid = (table - before)[:, 0], (table - before)[:, 1]
    if (executed < 0).any() or (paid < executed).any() or (len(table) and table[-1, 0] != len(poses)):
        raise ValueError(f"legs must rise to the {len(poses)} poses, and a frame be paid for each of them")
    times = np.zeros(len(poses), dtype=np.int64)
    times[keyframes] = factors
    found = []
    for (begin, _, _), (end, _, stays), count, frames in zip(before, table, executed, paid):
        if stays:
            found.append(PathSegment(poses[:0], (), stays=int(count)))
        else:
            found.append(PathSegment(poses[begin:end], tuple(times[begin:end].tolist()), lost=int(frames - count)))
    return found
