"""Edges, forest, betweenness, classification: by hand and against networkx."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest

from activestructure_gym.planes import (
    TopologyConfig,
    classify_structural,
    edge_weights,
    spanning_forest,
    tree_betweenness,
)


def random_graph(rng, count, density):
    weights = rng.uniform(0.05, 1.0, (count, count))
    weights = np.triu(weights, 1) + np.triu(weights, 1).T
    edges = np.triu(rng.uniform(size=(count, count)) < density, 1)
    return weights, edges | edges.T


def test_weights_by_hand():
    # 0 and 1 are parallel and 2 m apart, 2 stands at right angles to both and 1 m from plane 0.
    normals = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0]])
    centroids = np.array([[0.0, 0, 0], [2, 0, 0], [0, 1, 0]])
    weights = edge_weights(normals, centroids, beta=0.5, decay=0.5)
    assert weights[0, 1] == pytest.approx(1 - (0.5 + 0.5 * np.exp(-1.0)))  # 0.316
    assert weights[0, 2] == pytest.approx(1 - 0.5 * np.exp(-0.5))  # 0.697
    assert weights[1, 2] == pytest.approx(1 - 0.5 * np.exp(-0.5 * np.sqrt(5)))  # 0.837
    np.testing.assert_array_equal(weights, weights.T)
    assert (np.diag(weights) == 0).all()


def test_weights_read_the_plane_not_its_side(rng):
    normals = rng.standard_normal((6, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    centroids = rng.standard_normal((6, 3))
    flipped = normals * np.array([1, -1, 1, -1, -1, 1])[:, None]
    np.testing.assert_allclose(edge_weights(normals, centroids), edge_weights(flipped, centroids), atol=1e-15)


@pytest.mark.parametrize(("count", "density"), [(1, 1.0), (2, 1.0), (8, 0.3), (30, 0.1), (60, 0.5)])
def test_forest_and_betweenness_are_those_of_networkx(rng, count, density):
    for _ in range(4):
        weights, edges = random_graph(rng, count, density)
        tree = spanning_forest(weights, edges)
        graph = nx.from_numpy_array(np.where(edges, weights, 0.0))
        forest = nx.minimum_spanning_tree(graph)
        assert {tuple(sorted(e)) for e in forest.edges} == set(zip(*(k.tolist() for k in np.nonzero(np.triu(tree)))))
        np.testing.assert_array_equal(tree, tree.T)
        expected = nx.betweenness_centrality(forest)
        np.testing.assert_allclose(tree_betweenness(tree), [expected[k] for k in range(count)], atol=1e-12)


def test_a_star_by_hand():
    tree = np.zeros((5, 5), bool)
    tree[0, 1:] = tree[1:, 0] = True
    # All 6 pairs of leaves meet in the centre: 6 of (5 - 1)(5 - 2) / 2 = 6.
    np.testing.assert_allclose(tree_betweenness(tree), [1, 0, 0, 0, 0])


def test_ties_do_not_hang_on_the_last_digit(rng):
    """A square of four equal edges: rotating everything changes weights by 1e-16, never the tree."""
    weights = np.full((4, 4), 0.5)
    edges = np.zeros((4, 4), bool)
    for i, j in ((0, 1), (1, 2), (2, 3), (3, 0)):
        edges[i, j] = edges[j, i] = True
    tree = spanning_forest(weights, edges)
    assert tree.sum() == 6
    for _ in range(10):
        noise = rng.uniform(-1e-13, 1e-13, (4, 4))
        np.testing.assert_array_equal(spanning_forest(weights + noise + noise.T, edges), tree)


def test_an_edge_of_weight_zero_is_an_edge():
    assert spanning_forest(np.zeros((2, 2)), ~np.eye(2, dtype=bool))[0, 1]


def test_each_criterion_makes_a_plane_structural():
    config = TopologyConfig()
    betweenness = np.array([0.15, 0.14, 0.0, 0.0, 0.0])
    degree = np.array([2, 2, 3, 1, 1])
    area = np.array([0.1, 0.1, 0.1, 1.5, 1.5])
    points = np.array([10, 10, 10, 400, 399])
    structural = classify_structural(betweenness, degree, area, points, config)
    assert structural.tolist() == [True, False, True, True, False]  # area counts only together with points


def test_bad_configuration_is_refused():
    with pytest.raises(ValueError, match="beta must be a number from 0 to 1"):
        TopologyConfig(beta=1.4)
    with pytest.raises(ValueError, match="decay"):
        TopologyConfig(decay=-1.0)
