import numpy as np
import pytest
from scipy.spatial import cKDTree

from activestructure_gym.evaluation.metrics import nearest
from activestructure_gym.evaluation.metrics.nearest import PointTree


@pytest.mark.parametrize("count", [1, 8, 9, 500])
@pytest.mark.parametrize("shift", [0.0, 30.0])
def test_equals_scipy_near_and_far(rng, count, shift):
    points, queries = rng.normal(size=(count, 3)), rng.normal(size=(300, 3)) + shift
    distance, index = PointTree(points).query(queries)
    expected, which = cKDTree(points).query(queries)
    np.testing.assert_allclose(distance, expected, rtol=1e-12)
    np.testing.assert_array_equal(index, which)


def test_points_on_a_plane_or_all_at_one_place_are_no_special_case(rng):
    flat = np.column_stack([rng.integers(0, 5, (200, 2)), np.zeros(200)]).astype(float)
    queries = rng.normal(size=(100, 3)) * 4
    np.testing.assert_allclose(PointTree(flat).query(queries)[0], cKDTree(flat).query(queries)[0])
    same = np.ones((50, 3))
    assert PointTree(same).query(np.zeros((1, 3)))[0][0] == pytest.approx(np.sqrt(3))


def test_discs_equal_brute_force(rng):
    points, queries, radius = rng.normal(size=(200, 3)), rng.normal(size=(150, 3)) * 2, 0.3
    normals = rng.normal(size=(200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offset = queries[:, None] - points
    height = np.abs((offset * normals).sum(axis=2))
    beside = np.linalg.norm(offset - (offset * normals).sum(axis=2, keepdims=True) * normals, axis=2)
    expected = np.hypot(height, np.maximum(beside - radius, 0)).min(axis=1)
    np.testing.assert_allclose(PointTree(points, normals, radius).query(queries)[0], expected, atol=1e-9)


def test_nothing_to_find_and_nothing_to_ask(rng):
    distance, index = PointTree(np.zeros((0, 3))).query(np.zeros((2, 3)))
    assert np.isinf(distance).all() and (index == -1).all()
    assert len(PointTree(np.ones((3, 3))).query(np.zeros((0, 3)))[0]) == 0


def test_the_number_of_threads_changes_nothing(rng, monkeypatch):
    monkeypatch.setattr(nearest, "_CHUNK", 64)
    tree, queries = PointTree(rng.normal(size=(400, 3))), rng.normal(size=(1000, 3))
    answers = []
    for threads in (1, 3):
        monkeypatch.setattr(nearest, "thread_cap", lambda threads=threads: threads)
        answers.append(tree.query(queries)[0])
    np.testing.assert_array_equal(*answers)
