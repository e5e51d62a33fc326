"""What an event costs in one place while copies of a whole mapped apartment stand around it, to millions of Gaussians.

"storeys": the copies stand far above each other, outside every view. "floor": they stand side by side, inside the views
and behind the walls of the place. Copies have no keyframes of their own, so no step is spent on them.
"""

from __future__ import annotations

import copy
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping.gaussian_map import MEAN, GaussianMap
from activestructure_gym.mapping.mapper import Mapper
from activestructure_gym.scenes.scene import Scene
from benchmarks.growth import STOREY, places, processor_ms, quartiles

COUNTS = (250_000, 500_000, 1_000_000, 2_000_000)  # Gaussians
KEYFRAMES = (6, 120)  # of the place, and of the apartment that is copied
_A_ROW = 5  # copies side by side on a floor before the next row begins
_APART = 1.0  # metres between the copies of a floor

Where = Literal["storeys", "floor"]


@dataclass(frozen=True)
class CopiesRow:
    """One place in a small and in a large map; the same frames in both, one right after the other."""

    where: Where  # the copies stand
    gaussians: tuple[int, int]
    pairs: int
    event_ratio: tuple[float, float, float]  # lower quartile, median, upper quartile
    event_ms: tuple[float, float]  # processor time, medians
    mb_per_million: float  # the map's own arrays by a million Gaussians of room


def run_copies_benchmark(
    scene: Scene,
    mapper: Mapper,
    *,
    counts: Sequence[int] = COUNTS,
    keyframes: tuple[int, int] = KEYFRAMES,
    size: tuple[int, int],
    probes: int,
    seed: int = 0,
    rounds: int = 2,
    advance: Callable[[], None] = lambda: None,  # called as often as there are rows
) -> list[CopiesRow]:
    """Map a place and the whole apartment with ``mapper`` (empty), and compare the place alone with it among copies."""
    frames, probe_frames, _ = places(scene, keyframes[1], size, 1, probes, seed)
    place: Mapper | None = None
    for index, frame in enumerate(frames):
        mapper.observe(frame)
        if index + 1 == keyframes[0]:
            place = copy.deepcopy(mapper)
    assert place is not None, "the place has fewer keyframes than the apartment"
    whole, rows = mapper.map.parameters[:, : mapper.map.count], []
    for count in counts:
        for where in ("storeys", "floor"):
            rows.append(_compared(place, among_copies(place, whole, count, where), probe_frames, rounds, where))
            advance()
    return rows


def among_copies(
    place: Mapper,
    whole: np.ndarray,  # [14, n] Gaussians of the apartment that the place belongs to
    count: int,
    where: Where,
) -> Mapper:
    """A copy of ``place`` with copies of the apartment appended, moved by whole apartments, ``count`` in all."""
    grown, number = copy.deepcopy(place), 0
    extent = np.ptp(whole[MEAN], axis=1) + _APART
    while grown.map.count < count:
        number += 1
        row, column = divmod(number, _A_ROW)
        shift = (0.0, 0.0, STOREY * number) if where == "storeys" else (row * extent[0], column * extent[1], 0.0)
        block = whole[:, : count - grown.map.count].copy()
        block[MEAN] += np.array(shift, dtype=np.float32)[:, None]
        grown.map.append(block)
    return grown


def _compared(small: Mapper, large: Mapper, probe_frames: Sequence[Frame], rounds: int, where: Where) -> CopiesRow:
    times: list[tuple[float, float]] = []
    for _ in range(rounds):
        trials = [copy.deepcopy(mapper) for mapper in (small, large)]
        for trial in trials:
            trial.observe(probe_frames[0])  # not counted: the copies' arrays may have to grow
        for number, frame in enumerate(probe_frames):
            taken = {}
            for size in (0, 1) if number % 2 else (1, 0):  # nobody always comes second
                taken[size] = processor_ms(partial(trials[size].observe, frame))
            times.append((taken[0], taken[1]))
    return CopiesRow(
        where=where,
        gaussians=(small.map.count, large.map.count),
        pairs=len(times),
        event_ratio=quartiles([after / before for before, after in times]),
        event_ms=(statistics.median(a for a, _ in times), statistics.median(b for _, b in times)),
        mb_per_million=bytes_of(large.map) / large.map.capacity,
    )


def bytes_of(gaussians: GaussianMap) -> int:
    """Bytes of the arrays that are as long as the map's capacity."""
    arrays = (gaussians.parameters, gaussians.first_moment, gaussians.second_moment, gaussians.ids)
    return sum(array.nbytes for array in arrays)
