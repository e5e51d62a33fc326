"""Process arrays that are given in pieces: regroup them into batches, and sum them exactly as numpy does."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator

import numpy as np

_LEAF = 1 << 16  # longest stretch of numbers that one call of `np.sum` adds


def batched(pieces: Iterable[np.ndarray], size: int) -> Iterator[np.ndarray]:
    """Yield the rows of all pieces [n, ...] in arrays of ``size`` rows; the last array can be shorter."""
    waiting, rows = list[np.ndarray](), 0
    for piece in pieces:
        for start in range(0, len(piece), size):
            part = piece[start : start + size]
            while rows + len(part) >= size:
                waiting.append(part[: size - rows])
                yield np.concatenate(waiting)
                part, waiting, rows = part[size - rows :], [], 0
            waiting.append(part)
            rows += len(part)
    if rows:
        yield np.concatenate(waiting)


class StreamedSum:
    """Sum ``count`` numbers that are given in pieces; the result is bit-identical to `np.sum` of all of them.

    numpy splits a long array into halves, sums each half recursively, and adds the two sums. The same halves are used
    here, and only one short stretch of numbers is kept at a time.
    """

    def __init__(self, count: int) -> None:
        self._adding = _added(count)
        self._value: float | None = None
        self._waiting, self._rows = list[np.ndarray](), 0
        self._wanted = 0
        self._go_on(None)
        self.add(np.zeros(0))  # completes the sum if ``count`` is 0

    def add(self, numbers: np.ndarray) -> None:
        """Add the next numbers [n], float64."""
        while self._value is None and self._rows + len(numbers) >= self._wanted:
            taken = self._wanted - self._rows
            stretch = np.concatenate([*self._waiting, numbers[:taken]])
            numbers, self._waiting, self._rows = numbers[taken:], [], 0
            self._go_on(stretch)
        if len(numbers):
            self._waiting.append(np.array(numbers))
            self._rows += len(numbers)

    @property
    def value(self) -> float:
        """Return the sum; raise ValueError unless exactly ``count`` numbers were added."""
        if self._value is None or self._rows:
            raise ValueError("a streamed sum was given more or fewer numbers than were announced")
        return self._value

    def _go_on(self, stretch: np.ndarray | None) -> None:
        try:
            self._wanted = next(self._adding) if stretch is None else self._adding.send(stretch)
        except StopIteration as end:
            self._value = end.value


def _added(count: int) -> Generator[int, np.ndarray, float]:
    """Return the sum of ``count`` numbers as a generator: yield the length of the next stretch, receive its numbers."""
    if count <= _LEAF:
        return float((yield count).sum())
    half = count // 2
    half -= half % 8
    first = yield from _added(half)
    return first + (yield from _added(count - half))
