"""Many views of one map, measured side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from activestructure_gym.evaluation.machine.threads import thread_cap

T = TypeVar("T")


def every_view(measure: Callable[[int], T], count: int) -> list[T]:
    """``measure(0) ... measure(count - 1)``, as many at a time as there are cores.

    Views do not know of each other, so the result does not depend on the number of threads. One thread per view beats
    all threads on one view: nothing waits for the slowest tile.
    """
    threads = min(thread_cap(), count)
    if threads <= 1:
        return [measure(index) for index in range(count)]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(measure, range(count)))


def mean_of_known(values: Iterable[float | None]) -> float | None:
    """Mean of the values that are not None; None where there is none."""
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None
