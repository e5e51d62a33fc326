"""Eqs. 8 to 11, worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.planes import SurpriseConfig, information_deficit, structural_surprise
from activestructure_gym.planes.surprise import connectivity_surprise, geometric_surprise, neighbourhood_surprise

CONFIG = SurpriseConfig()


def pairs(count, *edges):
    matrix = np.zeros((count, count), bool)
    for i, j in edges:
        matrix[i, j] = matrix[j, i] = True
    return matrix


def test_connectivity_falls_with_degree_down_to_the_floor():
    np.testing.assert_allclose(connectivity_surprise(np.array([0, 1, 2, 3, 7]), CONFIG), [1, 2 / 3, 1 / 3, 0.1, 0.1])


def test_neighbourhood_counts_near_planes_without_a_relation():
    # 0, 1, 2 within 1.5 m of each other; 3 far away.
    centroids = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [9, 9, 9]])
    phi = neighbourhood_surprise(centroids, pairs(4, (0, 1), (0, 3)), CONFIG)
    # 0: one of two near planes linked; 1 likewise; 2: none of two; 3: nobody near, so nothing missing.
    np.testing.assert_allclose(phi, [0.55, 0.55, 1.0, 0.1], atol=1e-6)


def test_geometric_measures_the_distance_from_right_angles():
    a = np.radians(30.0)
    normals = np.array([[1.0, 0, 0], [0, 1, 0], [np.cos(a), np.sin(a), 0], [-1, 0, 0]])
    phi = geometric_surprise(normals, pairs(4, (0, 1), (0, 2)), CONFIG)
    # 0: neighbours at 90 and 30 deg -> deviations 0 and 30 of 45, mean 1/3; 2: 30 deg; 1: 90 deg; 3: no neighbour.
    np.testing.assert_allclose(phi, [0.1 + 0.9 / 3, 0.1, 0.1 + 0.9 * 2 / 3, 0.1], atol=1e-6)


def test_antiparallel_is_canonical():
    normals = np.array([[0.0, 0, 1], [0, 0, -1]])
    np.testing.assert_allclose(geometric_surprise(normals, pairs(2, (0, 1)), CONFIG), [0.1, 0.1], atol=1e-6)


def test_product_and_deficit():
    normals = np.eye(3)
    centroids = np.zeros((3, 3))
    surprise = structural_surprise(normals, centroids, pairs(3), pairs(3), CONFIG)
    # Nobody linked: connectivity 1, neighbourhood 1, geometry at the floor.
    np.testing.assert_allclose(surprise.total, [0.1] * 3, atol=1e-6)
    deficit = information_deficit(np.array([1.0, 0.5, 0.0]), surprise.total)
    np.testing.assert_allclose(deficit, [0, 0.05, 0.1], atol=1e-6)


def test_empty_graph():
    surprise = structural_surprise(np.zeros((0, 3)), np.zeros((0, 3)), pairs(0), pairs(0), CONFIG)
    assert surprise.total.shape == (0,)


@pytest.mark.parametrize("bad", [{"floor": 1.5}, {"radius": 0.0}, {"saturation_degree": 0}])
def test_bad_configuration_is_refused(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        SurpriseConfig(**bad)
