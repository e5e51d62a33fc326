"""Measure the time of a mapping event in one part of an apartment while the map grows to millions of Gaussians.

A mapping event is `Mapper.observe` of one frame. The map grows by shifted copies of the apartment. As "storeys", the
copies are far above each other, outside all views. As a "floor", they are next to each other, inside the views and
hidden behind walls. Copies have no keyframes, so the optimiser spends no step on them.
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

COUNTS = (250_000, 500_000, 1_000_000, 2_000_000)  # numbers of Gaussians in the large map
KEYFRAMES = (6, 120)  # number of keyframes of the small map (the place), and of the apartment that is copied
_A_ROW = 5  # number of copies in a row of a floor
_APART = 1.0  # metres between the copies of a floor

Where = Literal["storeys", "floor"]


@dataclass(frozen=True)
class CopiesRow:
    """Hold the times of mapping events in a small and in a large map, compared frame by frame."""

    where: Where  # arrangement of the copies
    gaussians: tuple[int, int]  # number in the small and in the large map
    pairs: int  # number of pairs of events with the same frame
    event_ratio: tuple[float, float, float]  # time in the large map / in the small map: quartile, median, quartile
    event_ms: tuple[float, float]  # median processor time in the small and in the large map
    mb_per_million: float  # MB of the map's arrays per million Gaussians of capacity


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
    """Compare the time of mapping events in a small map with the time in large maps around the same place.

    The empty ``mapper`` maps the apartment ``scene`` from ``keyframes[1]`` keyframes. The small map is its state after
    the first ``keyframes[0]`` of them. A large map is the small map and shifted copies of the whole apartment, together
    one of the numbers of Gaussians in ``counts``. ``size`` is (width, height) of the images in pixels. ``probes`` is
    the number of frames that are timed in both maps, and ``rounds`` is how often this is repeated.

    Return one row per count and arrangement of the copies.
    """
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
    whole: np.ndarray,  # [14, n] Gaussians of the whole apartment
    count: int,
    where: Where,
) -> Mapper:
    """Return a copy of the mapper ``place`` whose map has ``count`` Gaussians, by shifted copies of ``whole``.

    ``where`` is the arrangement of the copies: "storeys" or "floor".
    """
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
            trial.observe(probe_frames[0])  # not timed, since the arrays of a copied map may have to grow
        for number, frame in enumerate(probe_frames):
            taken = {}
            for size in (0, 1) if number % 2 else (1, 0):  # 0: small map, 1: large map; the order alternates
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
    """Return the memory in bytes of a map's arrays per Gaussian: parameters, moments of the optimiser, and ids."""
    arrays = (gaussians.parameters, gaussians.first_moment, gaussians.second_moment, gaussians.ids)
    return sum(array.nbytes for array in arrays)
