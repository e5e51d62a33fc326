"""Score reconstructed points against the true surface: accuracy, completion, completion ratio, precision, F-score."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from activestructure_gym.evaluation.metrics.nearest import PointTree
from activestructure_gym.evaluation.metrics.streams import StreamedSum, batched

_BATCH = 1 << 21  # points per search tree or query, which need 300 MB


@dataclass(frozen=True)
class SurfaceSamples:
    """Represent the true surface by samples of equal area.

    Parameters
    ----------
    points
        [S, 3] metres, world.
    normals
        [S, 3] unit vectors, on either side of the surface.
    area
        Area of the sampled surface in m^2.
    """

    points: np.ndarray
    normals: np.ndarray
    area: float

    @property
    def disc_radius(self) -> float:  # metres
        """Return the radius of a disc with twice the area of the surface per sample.

        Discs of this size around random samples cover 86 % of the surface (1 - exp(-2)).
        """
        return float(np.sqrt(2.0 * self.area / (np.pi * max(len(self.points), 1))))

    @cached_property
    def discs(self) -> PointTree:
        """Return a search tree over flat discs around the samples, perpendicular to their normals.

        The discs approximate the surface. For points exactly on the surface, the distance to the nearest sample is
        biased by half the sample spacing: 3.4 cm with 200,000 samples on 900 m^2. The distance to the nearest disc has
        a twentieth of this bias. At an open edge a disc can extend beyond the surface by its radius.
        """
        return PointTree(self.points, self.normals, self.disc_radius)

    @cached_property
    def samples(self) -> PointTree:
        """Return a search tree over the samples as points."""
        return PointTree(self.points)


@dataclass(frozen=True)
class GeometryScores:
    """Hold the scores of a reconstruction; None if a score is undefined (no points, no surface) or not measured."""

    accuracy_cm: float | None  # mean distance from a reconstructed point to the true surface
    sample_accuracy_cm: float | None  # mean distance to the nearest true sample, as most papers report it
    completion_cm: float | None  # mean distance from a true sample to the nearest reconstructed point
    completion_ratio: float | None  # % of the true samples with a reconstructed point nearer than the threshold
    precision: float | None  # % of the reconstructed points nearer to the surface than the threshold
    f_score: float | None  # %, harmonic mean of precision and completion ratio


def nearest_distances(queries: np.ndarray, points: np.ndarray) -> np.ndarray:  # [Q] metres
    """Return the distance from each query [Q, 3] to the nearest of ``points`` [P, 3]; inf if there are no points."""
    return streamed_distances(queries, [np.asarray(points, np.float64).reshape(-1, 3)])


def streamed_distances(queries: np.ndarray, pieces: Iterable[np.ndarray]) -> np.ndarray:  # [Q] metres
    """Return the distance from each query [Q, 3] to the nearest of points given in pieces [n, 3], in bounded memory.

    All coordinates are in metres. The distance is inf if there are no points.
    """
    nearest = NearestPoints(queries)
    for batch in batched(pieces, _BATCH):
        nearest.add(batch)
    return nearest.distances


class NearestPoints:
    """Compute the distance from each of fixed places [Q, 3] to the nearest of all points added so far, in metres."""

    def __init__(self, places: np.ndarray) -> None:
        self._places = np.asarray(places, np.float64).reshape(-1, 3)
        self.distances = np.full(len(self._places), np.inf)  # [Q] metres

    def add(self, points: np.ndarray) -> None:
        """Add points [P, 3] in metres and update ``distances``."""
        if not len(points):
            return
        # Search only for places whose distance to the bounding box of the new points is below their distance so far.
        # The factor allows for rounding.
        apart = np.maximum(np.maximum(points.min(axis=0) - self._places, self._places - points.max(axis=0)), 0.0)
        ask = np.linalg.norm(apart, axis=1) * (1.0 - 1e-9) < self.distances
        found = PointTree(points).query(self._places[ask])[0]
        self.distances[ask] = np.minimum(self.distances[ask], found)


def completion_distances(surface: SurfaceSamples, reconstructed: np.ndarray) -> np.ndarray:  # [S] metres
    """Return the distance from each sample of the true surface to the nearest ``reconstructed`` point [P, 3]."""
    return nearest_distances(surface.points, reconstructed)


def geometry_scores(
    reconstructed: np.ndarray,  # [P, 3] metres, world
    surface: SurfaceSamples,
    *,
    threshold_m: float = 0.05,
) -> GeometryScores:
    """Return accuracy, completion, completion ratio, precision and F-score of points against the true surface.

    Parameters
    ----------
    reconstructed
        [P, 3] points in metres, world. Points and samples that are not finite are ignored.
    surface
        Samples of the true surface.
    threshold_m
        Threshold in metres; a distance must be strictly below it. The literature uses 5 cm.

    Returns
    -------
    GeometryScores
        Scores in centimetres and percent; None if a score is undefined.

    Notes
    -----
    Source of precision, recall (here the completion ratio) and F-score: Knapitsch et al., "Tanks and Temples", ACM TOG
    2017.

    Examples
    --------
    >>> floor = np.stack([*np.meshgrid(np.arange(10) / 10, np.arange(10) / 10), np.zeros((10, 10))], -1).reshape(-1, 3)
    >>> surface = SurfaceSamples(floor, np.tile([0.0, 0.0, 1.0], (100, 1)), 1.0)
    >>> scores = geometry_scores(floor[:50] + [0.0, 0.0, 0.02], surface)
    >>> round(scores.accuracy_cm, 3), scores.completion_ratio, scores.precision
    (2.0, 50.0, 100.0)
    """
    reconstructed = np.asarray(reconstructed, dtype=np.float64).reshape(-1, 3)
    reconstructed = reconstructed[np.isfinite(reconstructed).all(axis=1)]
    return streamed_scores([reconstructed], len(reconstructed), surface, threshold_m=threshold_m, to_samples=True)


def streamed_scores(
    pieces: Iterable[np.ndarray],  # [n, 3] metres, world, finite
    count: int,  # number of points in all pieces together
    surface: SurfaceSamples,
    *,
    threshold_m: float,
    to_samples: bool,  # whether to compute ``sample_accuracy_cm``
) -> GeometryScores:
    """Return the `geometry_scores` of points that are given in pieces, bit-identical and in bounded memory."""
    real = np.isfinite(surface.points).all(axis=1)
    if not real.any():
        return GeometryScores(None, None, None, None, None, None)
    if not real.all():
        surface = SurfaceSamples(surface.points[real], surface.normals[real], surface.area)
    nearest, near = NearestPoints(surface.points), 0
    to_surface, to_sample = StreamedSum(count), StreamedSum(count if to_samples else 0)
    for batch in batched(pieces, _BATCH):
        nearest.add(batch)
        distances = surface.discs.query(batch)[0]
        near += int(np.count_nonzero(distances < threshold_m))
        to_surface.add(distances)
        if to_samples:
            to_sample.add(surface.samples.query(batch)[0])
    ratio = _percent(nearest.distances < threshold_m)
    if not count:
        return GeometryScores(None, None, None, ratio, 0.0, 0.0)
    precision = 100.0 * float(near) / count
    f_score = 2.0 * precision * ratio / (precision + ratio) if precision + ratio else 0.0
    return GeometryScores(
        accuracy_cm=100.0 * (to_surface.value / count),
        sample_accuracy_cm=100.0 * (to_sample.value / count) if to_samples else None,
        completion_cm=100.0 * float(nearest.distances.mean()),
        completion_ratio=ratio,
        precision=precision,
        f_score=f_score,
    )


def _percent(mask: np.ndarray) -> float:
    return 100.0 * float(np.count_nonzero(mask)) / max(len(mask), 1)
