import math

import numpy as np
import pytest

from activestructure_gym.evaluation.metrics import SurfaceSamples, geometry, geometry_scores, surface_points
from activestructure_gym.evaluation.metrics.fusion import triangle_areas
from activestructure_gym.evaluation.metrics.geometry import streamed_distances, streamed_scores
from activestructure_gym.evaluation.metrics.surface_points import SurfacePoints
from activestructure_gym.ground_truth.surface_samples import samples_by_area


@pytest.fixture(scope="module")
def triangles() -> np.ndarray:
    rng = np.random.default_rng(3)
    corners = rng.uniform(-2, 2, (3000, 1, 3)) + rng.normal(scale=0.1, size=(3000, 3, 3))
    corners[::7] = corners[::7, :1]  # some without any area, as those at the end
    corners[-5:] = 0.0
    return corners.astype(np.float32)


@pytest.mark.parametrize(("per_m2", "least"), [(2000.0, 10), (0.0, 5000), (50.0, 1)])
def test_points_of_pieces_are_those_of_the_whole(triangles, per_m2, least, monkeypatch):
    monkeypatch.setattr(surface_points, "_AT_ONCE", 777)
    areas = triangle_areas(triangles)
    count = max(least, math.ceil(per_m2 * float(areas.sum())))
    whole = samples_by_area(triangles, areas, count, np.random.default_rng(0))[0]
    cuts = [0, 1, 1, 8, 900, 901, 2995, 3000]
    points = SurfacePoints(lambda: (triangles[a:b] for a, b in zip(cuts, cuts[1:])), per_m2=per_m2, least=least)
    assert points.count == count and points.area == float(areas.sum())
    for _ in range(2):
        assert np.concatenate(list(points.pieces())).tobytes() == whole.tobytes()


def test_where_the_rounding_of_the_area_decides_the_sum_is_numpys(triangles, monkeypatch):
    monkeypatch.setattr(surface_points, "_ROUNDING", 0.1)  # so that it always may
    areas = triangle_areas(triangles)
    points = SurfacePoints(lambda: [triangles[:1000], triangles[1000:]], per_m2=777.0, least=1)
    assert points.count == math.ceil(777.0 * float(areas.sum()))


def test_nothing_has_no_points():
    for pieces in ([], [np.zeros((0, 3, 3), np.float32)], [np.zeros((4, 3, 3), np.float32)]):
        points = SurfacePoints(lambda pieces=pieces: pieces, per_m2=100.0, least=10)
        assert (points.count, points.area, list(points.pieces())) == (0, 0.0, [])


def test_scores_of_batches_are_those_of_the_whole(rng, monkeypatch):
    truth = SurfaceSamples(rng.uniform(-1, 1, (500, 3)), np.tile([0.0, 0.0, 1.0], (500, 1)), 4.0)
    points = rng.uniform(-1, 1, (20_000, 3))
    whole = geometry_scores(points, truth, threshold_m=0.1)
    monkeypatch.setattr(geometry, "_BATCH", 701)
    pieces = np.array_split(points, 37)
    assert streamed_scores(pieces, len(points), truth, threshold_m=0.1, to_samples=True) == whole
    assert geometry_scores(points, truth, threshold_m=0.1) == whole
    monkeypatch.undo()
    once = streamed_distances(truth.points, [points[np.argsort(points[:, 0])]])
    monkeypatch.setattr(geometry, "_BATCH", 50)
    assert streamed_distances(truth.points, [points[np.argsort(points[:, 0])]]).tobytes() == once.tobytes()
