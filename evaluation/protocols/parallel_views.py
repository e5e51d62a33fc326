"""Measure the views of one map in parallel threads."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from activestructure_gym.evaluation.machine.threads import thread_cap

T = TypeVar("T")


def measure_views(measure: Callable[[int], T], count: int) -> list[T]:
    """Return ``[measure(0), ..., measure(count - 1)]``, computed in parallel with one thread per view.

    ``measure`` is called with the index of a view. Views are independent, so the result does not depend on the number
    of threads. One thread per view is faster than all threads on one view, because no thread waits for the slowest tile
    of an image.
    """
    threads = min(thread_cap(), count)
    if threads <= 1:
        return [measure(index) for index in range(count)]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(measure, range(count)))


def mean_of_defined(values: Iterable[float | None]) -> float | None:
    """Return the mean of the values that are not None; None if all are None."""
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None
