"""Choose the procedural layouts for training, validation and test; their ranges of seeds are disjoint.

Seeds below 100,000 are left to users and to the published comparisons.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from activestructure_gym.errors import InputError

FIRST_SEED = {"validation": 100_000, "test": 200_000, "train": 300_000}
_MAX_LAYOUTS = 100_000  # largest number of layouts for one use


def layout_specs(use: str, count: int, rooms: Sequence[int], *, lit: bool = True) -> tuple[str, ...]:
    """Return the names of the first ``count`` layouts for ``use``: "train", "validation" or "test".

    ``rooms`` are numbers of rooms, which consecutive layouts take in turn. Without ``lit``, a layout has the same
    triangles but no light and no textures, and is built 4 to 8 times as fast.
    """
    if not 0 <= count <= _MAX_LAYOUTS:
        raise InputError(f"the number of layouts must be from 0 to {_MAX_LAYOUTS}, got {count}")
    first, ending = FIRST_SEED[use], "" if lit else "&lit=false"
    return tuple(f"apartment?rooms={rooms[i % len(rooms)]}&seed={first + i}{ending}" for i in range(count))


def layout_order(seed: int, count: int) -> np.ndarray:  # [count]
    """Return a random permutation of the indices of ``count`` training layouts."""
    return np.random.default_rng([seed, 0, count]).permutation(count)
