"""The graph as observation arrays: sizes, bounds, order."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.planes import (
    PLANE_FEATURE_HIGH,
    PLANE_FEATURE_LOW,
    PLANE_FEATURES,
    PlaneSceneGraph,
    plane_features,
)


@pytest.fixture
def graph(furnished_room, furnished_views, new_graph):
    graph = new_graph()
    for position, direction in furnished_views[:8]:
        graph.update(furnished_room.shoot(position, direction)[0])
    assert len(graph.nodes) > 8
    return graph


def column(arrays, name):
    return arrays.features[arrays.mask == 1, PLANE_FEATURES.index(name)]


def test_bounds_are_finite_and_named_once():
    assert len(set(PLANE_FEATURES)) == len(PLANE_FEATURES) == len(PLANE_FEATURE_LOW) == len(PLANE_FEATURE_HIGH)
    assert PLANE_FEATURE_LOW.dtype == PLANE_FEATURE_HIGH.dtype == np.float32
    assert np.isfinite(PLANE_FEATURE_LOW).all() and np.isfinite(PLANE_FEATURE_HIGH).all()
    assert (PLANE_FEATURE_LOW <= 0).all() and (PLANE_FEATURE_HIGH > 0).all()  # 0, the padding, is inside


def test_all_planes_fit(graph):
    count = len(graph.nodes)
    arrays = graph.arrays(64)
    assert arrays.features.shape == (64, len(PLANE_FEATURES)) and arrays.features.dtype == np.float32
    assert arrays.mask.tolist() == [1] * count + [0] * (64 - count) and arrays.mask.dtype == np.int8
    assert arrays.edge_weights.shape == arrays.tree.shape == (64, 64)
    assert arrays.edge_weights.dtype == np.float32 and arrays.tree.dtype == np.int8
    assert not arrays.features[count:].any() and not arrays.edge_weights[count:].any() and not arrays.tree[count:].any()
    assert ((arrays.features >= PLANE_FEATURE_LOW) & (arrays.features <= PLANE_FEATURE_HIGH)).all()
    np.testing.assert_array_equal(arrays.nodes, np.arange(count))
    np.testing.assert_allclose(column(arrays, "deficit"), graph.state.deficit, rtol=1e-6)
    np.testing.assert_allclose(column(arrays, "quality_interior"), graph.state.quality.modes[:, 7], rtol=1e-6)
    np.testing.assert_allclose(column(arrays, "centroid_y"), graph.state.centroids[:, 1], rtol=1e-6)
    np.testing.assert_allclose(column(arrays, "observations"), [n.observations for n in graph.nodes])
    np.testing.assert_allclose(column(arrays, "degree"), graph.state.tree.sum(axis=1))
    np.testing.assert_array_equal(arrays.edge_weights[:count, :count] > 0, graph.state.edges)
    np.testing.assert_array_equal(arrays.tree[:count, :count] == 1, graph.state.tree)


def test_the_largest_are_kept_when_there_are_too_many(graph):
    arrays = graph.arrays(5)
    kept = graph.state.areas[arrays.nodes]
    assert arrays.mask.tolist() == [1] * 5
    assert (np.diff(arrays.nodes) > 0).all()
    assert kept.min() >= np.delete(graph.state.areas, arrays.nodes).max()
    np.testing.assert_allclose(column(arrays, "area"), kept, rtol=1e-6)
    weights = np.where(graph.state.edges, graph.state.weights, 0.0)[np.ix_(arrays.nodes, arrays.nodes)]
    np.testing.assert_allclose(arrays.edge_weights, weights, rtol=1e-6)


def test_an_empty_graph_is_all_zero():
    arrays = PlaneSceneGraph().arrays(8)
    for array in (arrays.features, arrays.mask, arrays.edge_weights, arrays.tree):
        assert not array.any()
    assert arrays.nodes.shape == (0,)
    assert plane_features(PlaneSceneGraph().state).shape == (0, len(PLANE_FEATURES))


def test_values_beyond_the_bounds_are_clipped(graph):
    graph.state.offsets[0] = -1e9
    assert graph.arrays(64).features[0, PLANE_FEATURES.index("offset")] == -1000.0


def test_at_least_one_row(graph):
    with pytest.raises(ValueError, match="max_planes must be at least 1"):
        graph.arrays(0)
