"""Which procedural layouts train, validate and test. Their seeds come from ranges that never meet.

Seeds below 100,000 are left alone: those are what people and the published comparisons play with.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from activestructure_gym.errors import InputError

FIRST_SEED = {"validation": 100_000, "test": 200_000, "train": 300_000}
_MAX_LAYOUTS = 100_000  # layouts of a kind


def layout_specs(use: str, count: int, rooms: Sequence[int], *, lit: bool = True) -> tuple[str, ...]:
    """The first ``count`` layouts for ``use`` ("train", "validation" or "test"), the numbers of rooms in turn.

    Layouts that are not ``lit`` are the same triangles without light and textures; an eighth to a quarter of the time.
    """
    if not 0 <= count <= _MAX_LAYOUTS:
        raise InputError(f"the number of layouts must be from 0 to {_MAX_LAYOUTS}, got {count}")
    first, ending = FIRST_SEED[use], "" if lit else "&lit=false"
    return tuple(f"apartment?rooms={rooms[i % len(rooms)]}&seed={first + i}{ending}" for i in range(count))


def layout_order(seed: int, count: int) -> np.ndarray:  # [count]
    """The order in which training goes through its layouts: all of them once before any comes again."""
    return np.random.default_rng([seed, 0, count]).permutation(count)
