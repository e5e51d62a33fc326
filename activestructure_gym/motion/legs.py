"""The way from one decision to the next, as it was executed, so that it can be followed again frame by frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

# Keyframes between two decisions of a trajectory that has none: at every decision it is measured anew how well
# keyframes are mapped, which the mapper goes by (own choice).
KEYFRAMES_PER_LEG = 4


@dataclass(frozen=True)
class Leg:
    """What happens between two decisions."""

    poses: np.ndarray  # [T, 4, 4] world_from_camera, one per frame, without the one before
    rounds: tuple[int, ...]  # [T] times the mapper's iterations with which the frame is mapped; 0 = no keyframe
    lost: int = 0  # frames paid without a pose: a view that no way leads to, a row that is none
    stays: int = 0  # frames spent in place to optimise; then there are no poses


def regular_legs(poses: np.ndarray, keyframe_every: int) -> list[Leg]:
    """A trajectory [T, 4, 4] whose keyframes are every n-th frame and the last; its first pose is where it starts."""
    frames = np.arange(2, len(poses) + 1)  # paid when each pose behind the first is reached
    mapped = (frames % keyframe_every == 0) | (frames == len(poses))
    ends = np.flatnonzero(mapped)[KEYFRAMES_PER_LEG - 1 :: KEYFRAMES_PER_LEG] + 1
    legs = []
    for begin, end in zip([0, *ends], [*ends, len(frames)]):
        if begin < end:
            legs.append(Leg(poses[1 + begin : 1 + end], tuple(int(keyframe) for keyframe in mapped[begin:end])))
    return legs


def recorded_legs(arrays: Mapping[str, np.ndarray]) -> list[Leg]:
    """The legs of a run's ``trajectory.npz``; ValueError where its arrays do not fit together.

    ``legs`` [D, 3] has poses executed and frames paid by the end of each decision, and 1 where they were spent in
    place to optimise; ``keyframe_rounds`` [K] the rounds of each of ``keyframes``.
    """
    poses, table = arrays["world_from_camera"], np.asarray(arrays["legs"])
    keyframes, rounds = np.asarray(arrays["keyframes"]), np.asarray(arrays["keyframe_rounds"])
    if table.ndim != 2 or table.shape[1] != 3 or table.dtype.kind not in "iu" or rounds.dtype.kind not in "iu":
        raise ValueError(f"legs must be whole numbers [D, 3], got {table.dtype} {table.shape}")
    table = table.astype(np.int64)  # unsigned ones would become fractions below
    if keyframes.ndim != 1 or keyframes.dtype.kind not in "iu" or (keyframes < 0).any():
        raise ValueError(f"keyframes must be whole numbers [K] from 0 on, got {keyframes.dtype} {keyframes.shape}")
    if rounds.shape != keyframes.shape or (rounds < 0).any() or (rounds > 1000).any():
        raise ValueError(f"keyframe_rounds must have a number from 0 to 1000 for each of {len(keyframes)} keyframes")
    before = np.vstack([[[1, 1, 0]], table])[:-1]
    executed, paid = (table - before)[:, 0], (table - before)[:, 1]
    if (executed < 0).any() or (paid < executed).any() or (len(table) and table[-1, 0] != len(poses)):
        raise ValueError(f"legs must rise to the {len(poses)} poses, and a frame be paid for each of them")
    times = np.zeros(len(poses), dtype=np.int64)
    times[keyframes] = rounds
    found = []
    for (begin, _, _), (end, _, stays), count, frames in zip(before, table, executed, paid):
        if stays:
            found.append(Leg(poses[:0], (), stays=int(count)))
        else:
            found.append(Leg(poses[begin:end], tuple(times[begin:end].tolist()), lost=int(frames - count)))
    return found
