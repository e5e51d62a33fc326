"""Which procedural layouts train, validate and test. Their seeds come from ranges that never meet."""

from __future__ import annotations

from collections.abc import Sequence

from activestructure_gym.errors import InputError

FIRST_SEED = {"train": 0, "validation": 100_000, "test": 200_000}
_LARGEST = 100_000  # layouts of a kind


def layout_specs(use: str, count: int, rooms: Sequence[int]) -> tuple[str, ...]:
    """The first ``count`` layouts for ``use`` ("train", "validation" or "test"), the numbers of rooms in turn."""
    if not 0 <= count <= _LARGEST:
        raise InputError(f"there are at most {_LARGEST} layouts of a kind, got {count}")
    first = FIRST_SEED[use]
    return tuple(f"apartment?rooms={rooms[i % len(rooms)]}&seed={first + i}" for i in range(count))
