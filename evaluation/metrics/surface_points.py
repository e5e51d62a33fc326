"""Points on a surface whose triangles come in pieces: those of `samples_by_area` on all of them, to the last bit."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from activestructure_gym.evaluation.metrics.fusion import triangle_areas
from activestructure_gym.evaluation.metrics.streams import StreamedSum
from activestructure_gym.ground_truth.surface_samples import on_triangles

_AT_ONCE = 1 << 18  # random numbers that are drawn ahead
_ROUNDING = 1e-12  # by which two sums of the same areas can differ, as a share


class SurfacePoints:
    """Points uniform by area on a surface, the same ones for the same triangles.

    Parameters
    ----------
    triangles
        Gives the triangles in pieces [n, 3, 3], metres. It is called once here, and once for the points.
    per_m2
        Points per square metre.
    least
        Points at least, wherever there is any surface.
    """

    def __init__(self, triangles: Callable[[], Iterable[np.ndarray]], *, per_m2: float, least: int) -> None:
        self._triangles, self._count = triangles, 0
        self._end = 0.0  # of the areas, added up one after the other
        sums = []
        for piece in triangles():
            areas = triangle_areas(piece)
            self._count += len(areas)
            self._end = float(_running(areas, self._end)[-1])
            sums.append(float(areas.sum()))
        self._area: float | None = None
        about = math.fsum(sums)
        counts = {math.ceil(per_m2 * about * (1.0 + off)) for off in (-_ROUNDING, _ROUNDING)}
        # Where the order of the sum decides about a point, the sum is numpy's.
        wanted = counts.pop() if len(counts) == 1 else math.ceil(per_m2 * self.area)
        self.count = max(least, wanted) if self._end > 0.0 else 0

    @property
    def area(self) -> float:  # m^2
        """Area of all triangles together, as numpy adds them up."""
        if self._area is None:
            total = StreamedSum(self._count)
            for piece in self._triangles():
                total.add(triangle_areas(piece))
            self._area = total.value
        return self._area

    def pieces(self) -> Iterator[np.ndarray]:  # [n, 3] metres
        """The points, some at a time."""
        if not self.count:
            return
        draws, total, end, count = _Draws(self.count, self._end), StreamedSum(self._count), 0.0, 0
        for piece in self._triangles():
            if not len(piece):
                continue
            areas = triangle_areas(piece)
            total.add(areas)
            count += len(areas)
            ends = _running(areas, end)
            end = float(ends[-1])
            drawn, u, v = draws.below(end if count < self._count else math.inf)
            faces = np.minimum(np.searchsorted(ends, drawn, side="right"), len(ends) - 1)
            yield on_triangles(piece[faces], u, v)
        self._area = total.value  # which costs nothing here


class _Draws:
    """The random numbers of `samples_by_area`, some at a time: three long rows of one generator."""

    def __init__(self, count: int, total: float) -> None:
        self._count, self._total = count, total
        self._rows = [np.random.default_rng(0) for _ in range(3)]
        for number, row in enumerate(self._rows):
            row.bit_generator.advance(number * count)  # type: ignore[attr-defined]
        self._at, self._ahead = 0, np.zeros(0)

    def below(self, end: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the next places on the cumulated area that are below ``end``, and two more numbers for each."""
        ahead = [self._ahead]
        while self._at < self._count and not (len(ahead[-1]) and ahead[-1][-1] >= end):
            number = np.arange(self._at, min(self._at + _AT_ONCE, self._count))
            ahead.append((number + self._rows[0].random(len(number))) / self._count * self._total)
            self._at += len(number)
        places = np.concatenate(ahead)
        count = int(np.searchsorted(places, end, side="left"))
        self._ahead = places[count:]
        return places[:count], self._rows[1].random(count), self._rows[2].random(count)


def _running(areas: np.ndarray, before: float) -> np.ndarray:
    """Return the running sums of areas that come after others."""
    if not len(areas):
        return np.array([before])
    return np.cumsum(np.concatenate([[before], areas]))[1:]
