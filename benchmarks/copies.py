"""Measure a mapping event in one place while the map grows by copies of an apartment, to millions of Gaussians.

The copies are "storeys" far above each other, outside every view, or a "floor" of apartments side by side, inside the
views and behind the walls of the place. Copies have no keyframes, so no optimiser step is spent on them.
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
KEYFRAMES = (6, 120)  # keyframes of the place, and of the apartment that is copied
_A_ROW = 5  # copies side by side on a floor before the next row begins
_APART = 1.0  # metres between the copies of a floor

Where = Literal["storeys", "floor"]


@dataclass(frozen=True)
class CopiesRow:
    """Hold the costs of one place in a small and in a large map, by pairs of events with the same frame."""

    where: Where  # arrangement of the copies
    gaussians: tuple[int, int]
    pairs: int
    event_ratio: tuple[float, float, float]  # lower quartile, median, upper quartile
    event_ms: tuple[float, float]  # processor time, medians
    mb_per_million: float  # memory of the map's arrays per million Gaussians of capacity


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
    advance: Callable[[], None] = lambda: None,  # called once per row
) -> list[CopiesRow]:
    """Map an apartment with the empty ``mapper``; compare one place of it alone and among copies of the apartment."""
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
    """Return a copy of ``place`` with shifted copies of the apartment appended, ``count`` Gaussians in all."""
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
            trial.observe(probe_frames[0])  # not timed, since the copies' arrays may have to grow
        for number, frame in enumerate(probe_frames):
            taken = {}
            for size in (0, 1) if number % 2 else (1, 0):  # alternating order
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
    """Return the bytes of the arrays that are as long as the map's capacity."""
    arrays = (gaussians.parameters, gaussians.first_moment, gaussians.second_moment, gaussians.ids)
    return sum(array.nbytes for array in arrays)
