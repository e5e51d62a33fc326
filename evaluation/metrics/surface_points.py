"""Sample points on a surface whose triangles are given in pieces, bit-identical to `samples_by_area` on all of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from activestructure_gym.evaluation.metrics.fusion import triangle_areas
from activestructure_gym.evaluation.metrics.streams import StreamedSum
from activestructure_gym.ground_truth.surface_samples import on_triangles

_AT_ONCE = 1 << 18  # number of random numbers drawn at once
_ROUNDING = 1e-12  # largest relative difference between two sums of the same areas


class SurfacePoints:
    """Sample points uniformly by area on a surface of triangles; the same triangles always give the same points.

    Parameters
    ----------
    triangles
        Function that returns the corners of the triangles in pieces [n, 3, 3], metres. It is called once at
        construction, once for the points, and once more if the exact area is needed before the points.
    per_m2
        Points per square metre.
    least
        Minimum number of points on a surface that is not empty.
    """

    def __init__(self, triangles: Callable[[], Iterable[np.ndarray]], *, per_m2: float, least: int) -> None:
        self._triangles, self._count = triangles, 0
        self._end = 0.0  # m^2, sum of all areas, added one after the other
        sums = []
        for piece in triangles():
            areas = triangle_areas(piece)
            self._count += len(areas)
            self._end = float(_running(areas, self._end)[-1])
            sums.append(float(areas.sum()))
        self._area: float | None = None
        about = math.fsum(sums)
        counts = {math.ceil(per_m2 * about * (1.0 + off)) for off in (-_ROUNDING, _ROUNDING)}
        # If the rounding of the sum could change the number of points, add the areas in numpy's order.
        wanted = counts.pop() if len(counts) == 1 else math.ceil(per_m2 * self.area)
        self.count = max(least, wanted) if self._end > 0.0 else 0

    @property
    def area(self) -> float:  # m^2
        """Return the total area of all triangles, added in numpy's order."""
        if self._area is None:
            total = StreamedSum(self._count)
            for piece in self._triangles():
                total.add(triangle_areas(piece))
            self._area = total.value
        return self._area

    def pieces(self) -> Iterator[np.ndarray]:  # [n, 3] metres
        """Yield the sampled points in pieces."""
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
        self._area = total.value  # cached: it is available here without a further pass over the triangles


class _Draws:
    """Draw the random numbers of `samples_by_area` in pieces.

    `samples_by_area` draws three arrays of ``count`` numbers from one generator, one after the other. Here three copies
    of the generator begin where these arrays begin. ``total`` is the area of the surface in m^2.
    """

    def __init__(self, count: int, total: float) -> None:
        self._count, self._total = count, total
        self._rows = [np.random.default_rng(0) for _ in range(3)]
        for number, row in enumerate(self._rows):
            row.bit_generator.advance(number * count)  # type: ignore[attr-defined]
        self._at, self._ahead = 0, np.zeros(0)

    def below(self, end: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the next places below ``end`` on the cumulative area, and two uniform random numbers for each.

        The three arrays are [n]; the places and ``end`` are in m^2, the random numbers in [0, 1).
        """
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
    """Return the cumulative sums of ``areas`` [n], added to the sum ``before``; all in m^2."""
    if not len(areas):
        return np.array([before])
    return np.cumsum(np.concatenate([[before], areas]))[1:]
