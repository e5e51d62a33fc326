"""Choose the poses of a trajectory that are mapped."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.trajectories.alignment import MAX_APART_S, nearest_stamps
from activestructure_gym.scenes.loaders.pose_text import numbers_of


def every_of(text: str) -> int | None:
    """Return N if ``text`` asks for every N-th pose ("all" is 1), and None if it is the name of a file.

    Raise `InputError` for a number below 1.
    """
    if text == "all":
        return 1
    try:
        every = int(text)
    except ValueError:
        return None
    if every < 1:
        raise InputError(f"keyframes must be all, a number from 1, or a file, got {every}")
    return every


def listed_poses(file: Path, count: int, stamps: np.ndarray | None) -> np.ndarray:  # [count] bool
    """Return a mask of the poses that a text file lists, by index from 0 or by time stamp in seconds.

    Whole numbers below ``count`` are indices. Otherwise each number is a time stamp, and the nearest of ``stamps``
    [count] is meant, at most 0.02 s away. Raise `InputError` for other numbers.
    """
    asked = numbers_of(file).ravel()
    mask = np.zeros(count, dtype=bool)
    if not np.isfinite(asked).all():
        raise InputError(f"'{file}' lists a keyframe that is not a finite number")
    if (asked == np.round(asked)).all() and (asked >= 0).all() and (asked < count).all():
        mask[asked.astype(np.int64)] = True
        return mask
    if stamps is None:
        raise InputError(
            f"'{file}' lists keyframes that are not indices from 0 to {count - 1}, and the trajectory has no "
            "time stamps"
        )
    nearest = nearest_stamps(stamps, asked)
    apart = np.abs(stamps[nearest] - asked)
    if (apart > MAX_APART_S).any():
        at = int(np.argmax(apart))
        raise InputError(
            f"keyframe {asked[at]:.3f} of '{file}' is neither an index from 0 to {count - 1} nor within "
            f"{MAX_APART_S:g} s of a time stamp ({stamps[0]:.3f} to {stamps[-1]:.3f} s)"
        )
    mask[nearest] = True
    return mask
