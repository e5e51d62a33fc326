import numpy as np
import pytest

from activestructure_gym.evaluation.metrics.voxels import matched_distances, nearest_per_voxel


def test_one_point_per_voxel_the_nearest_to_its_centre():
    points = np.array([[0.1, 0.1, 0.1], [0.4, 0.5, 0.5], [-0.1, 0.5, 0.5], [1.9, 0.2, 0.9], [0.5, 0.5, 0.9]])
    chosen, centres = nearest_per_voxel(points, 1.0)
    assert sorted(chosen) == [1, 2, 3]
    np.testing.assert_array_equal(centres[np.argsort(chosen)], [[0.5, 0.5, 0.5], [-0.5, 0.5, 0.5], [1.5, 0.5, 0.5]])


def test_no_points():
    chosen, centres = nearest_per_voxel(np.zeros((0, 3)), 0.01)
    assert chosen.shape == (0,) and centres.shape == (0, 3)
    to_true, from_true = matched_distances(np.zeros((0, 3)), np.ones((2, 3)), np.ones((2, 3)))
    assert np.isinf(to_true).all() and np.isinf(from_true).all()


def test_matching_by_hand():
    # Two true points 10 cm apart, one reconstructed point 1 cm above the first, one far away in the air.
    true = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
    points = np.array([[0.0, 0.0, 0.01], [0.0, 5.0, 5.0]])
    to_true, from_true = matched_distances(points, true, true)
    np.testing.assert_allclose(to_true, [0.01, 0.01])  # the same point twice; the one in the air is nobody's nearest
    np.testing.assert_allclose(from_true, [0.01, np.hypot(0.1, 0.01)])
    assert from_true[0] == pytest.approx(0.01)
