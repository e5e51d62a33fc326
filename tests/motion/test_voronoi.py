"""Floor plans whose medial lines are known: rectangles, doors, pillars, dead ends."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest

from activestructure_gym.motion import VoronoiGraph, free_plan, planar_graph, voronoi_graph
from activestructure_gym.volume import FREE, OCCUPIED, UNKNOWN, VoxelVolume

CELL = 0.1
RADIUS = 0.2


def plan(width: float, depth: float) -> np.ndarray:  # [X, Y] bool: a free rectangle with a wall around it
    free = np.zeros((round(width / CELL) + 2, round(depth / CELL) + 2), bool)
    free[1:-1, 1:-1] = True
    return free


def graph_of(free: np.ndarray, radius: float = RADIUS) -> VoronoiGraph:
    """With coordinates from the inner corner of the rectangle."""
    return voronoi_graph(free, np.array([-CELL, -CELL]), CELL, radius=radius)


def test_a_rectangle_has_the_two_ends_of_its_middle_line() -> None:
    graph = graph_of(plan(6.0, 4.0))
    np.testing.assert_allclose(graph.nodes, [[2.0, 2.0], [4.0, 2.0]], atol=0.06)
    np.testing.assert_allclose(graph.clearance, 2.0 - CELL / 2, atol=0.02)
    np.testing.assert_array_equal(graph.edges, [[0, 1]])
    np.testing.assert_allclose(graph.lengths, 2.0, atol=0.1)
    # The four diagonals are cut off, two from each node, and end near the corners.
    np.testing.assert_array_equal(np.sort(graph.chain_nodes), [0, 0, 1, 1])
    corners = np.array([[0, 0], [0, 4], [6, 0], [6, 4]], float)
    nearest = np.linalg.norm(graph.chain_ends[:, None] - corners, axis=2)
    assert sorted(nearest.argmin(axis=1)) == [0, 1, 2, 3]
    assert nearest.min(axis=1).max() < 0.5


def test_a_square_has_its_centre() -> None:
    graph = graph_of(plan(4.0, 4.0))
    np.testing.assert_allclose(graph.nodes, [[2.0, 2.0]], atol=0.06)
    assert len(graph.edges) == 0
    assert len(graph.chain_nodes) == 4


def test_a_door_connects_two_rooms_and_one_too_narrow_does_not() -> None:
    free = plan(8.2, 4.0)
    free[41:43] = False
    free[41:43, 17:25] = True
    wide = graph_of(free)
    np.testing.assert_allclose(wide.nodes, [[2.0, 2.0], [6.2, 2.0]], atol=0.15)
    np.testing.assert_array_equal(wide.edges, [[0, 1]])
    assert 4.0 < wide.lengths[0] < 5.5
    narrow = graph_of(free, radius=0.45)
    assert len(narrow) == 2
    assert len(narrow.edges) == 0
    assert np.isinf(narrow.distances[0, 1])


def test_around_a_pillar_the_graph_is_a_ring() -> None:
    free = plan(6.0, 6.0)
    free[26:37, 26:37] = False
    graph = graph_of(free)
    assert len(graph) == 4
    assert sorted(dict(nx.Graph(graph.edges.tolist()).degree).values()) == [2, 2, 2, 2]
    assert nx.cycle_basis(nx.Graph(graph.edges.tolist()))


def test_distances_are_the_shortest_ways() -> None:
    graph = VoronoiGraph(
        np.zeros((4, 2)), np.ones(4), np.array([[0, 1], [1, 2], [0, 2]]), np.array([1.0, 1.5, 4.0]),
        np.zeros((0, 2)), np.zeros(0, np.int64),
    )  # fmt: skip
    inf = np.inf
    np.testing.assert_array_equal(
        graph.distances, [[0, 1, 2.5, inf], [1, 0, 1.5, inf], [2.5, 1.5, 0, inf], [inf] * 3 + [0]]
    )


def test_lengths_are_never_below_the_straight_line_and_nodes_keep_the_radius(rng: np.random.Generator) -> None:
    free = plan(12.0, 10.0)
    for x, y in rng.integers(5, 80, (12, 2)):
        free[x : x + rng.integers(3, 12), y : y + rng.integers(3, 12)] = False
    graph = graph_of(free)
    assert len(graph) > 8
    assert (graph.clearance > RADIUS).all()
    straight = np.linalg.norm(graph.nodes[graph.edges[:, 0]] - graph.nodes[graph.edges[:, 1]], axis=1)
    assert (graph.lengths >= straight - 1e-9).all()
    # The stated clearance is that of the cells, up to a cell's diagonal and what the outline was simplified by.
    blocked = (np.argwhere(~free) - 0.5) * CELL
    nearest = np.linalg.norm(graph.nodes[:, None] - blocked, axis=2).min(axis=1)
    assert np.abs(nearest - graph.clearance).max() < 0.3
    again = graph_of(free)
    np.testing.assert_array_equal(graph.nodes, again.nodes)


@pytest.mark.parametrize("cells", [0, 2])
def test_no_room_no_node(cells: int) -> None:
    free = np.zeros((12, 12), bool)
    free[4 : 4 + cells, 4 : 4 + cells] = True
    graph = graph_of(free)
    assert len(graph) == len(graph.edges) == len(graph.chain_ends) == 0
    assert graph.distances.shape == (0, 0)


def test_the_plan_is_the_layer_of_the_place_without_other_rooms_and_without_specks() -> None:
    volume = VoxelVolume(np.array([[0.0, 0, 0], [6.0, 4, 2.5]]))
    volume.state[:] = UNKNOWN
    k = volume.voxel_of(np.array([0.0, 0.0, 1.25]))[2]
    layer = volume.state[:, :, k]
    layer[1:40, 1:-1] = FREE
    layer[45:-1, 1:-1] = FREE  # behind a wall
    layer[10:12, 10:12] = UNKNOWN  # a speck
    layer[20, 20] = OCCUPIED  # a pole
    layer[30:33, 30:33] = UNKNOWN  # more than a speck
    free = free_plan(volume, np.array([1.0, 1.0, 1.25]))
    expected = np.zeros_like(free)
    expected[1:40, 1:-1] = True
    expected[20, 20] = expected[30:33, 30:33] = False
    np.testing.assert_array_equal(free, expected)
    assert not free_plan(volume, np.array([1.0, 1.0, 2.0])).any()
    assert not free_plan(volume, np.array([9.0, 1.0, 1.25])).any()
    graph = planar_graph(volume, np.array([1.0, 1.0, 1.25]))
    assert len(graph)
    cells = volume.voxel_of(np.column_stack([graph.nodes, np.full(len(graph), 1.25)]))
    assert free[cells[:, 0], cells[:, 1]].all()


def test_a_table_below_the_camera_and_a_lamp_above_it_block_the_plan() -> None:
    volume = VoxelVolume(np.array([[0.0, 0, 0], [6.0, 4, 2.7]]))
    volume.state[:] = FREE
    k = volume.voxel_of(np.array([1.0, 1.0, 1.55]))[2]
    volume.state[:, :, 1] = OCCUPIED  # the ground
    above = 2
    volume.state[10:14, 10:14, k - 6] = OCCUPIED  # a table
    volume.state[20:24, 20:24, above + 19] = OCCUPIED  # a lamp, lower than 2 m
    volume.state[30:34, 10:14, above + 20] = OCCUPIED  # a beam above the head
    volume.state[30:34, 20:24, above + 1] = OCCUPIED  # a carpet edge below the foot
    free = free_plan(volume, np.array([1.0, 1.0, 1.55]))
    expected = np.ones_like(free)
    expected[10:14, 10:14] = expected[20:24, 20:24] = False
    np.testing.assert_array_equal(free, expected)
    np.testing.assert_array_equal(
        free_plan(volume, volume.center_of(np.array([11, 11, k]))), expected
    )  # over the table


def test_without_a_known_ground_the_layer_of_the_agent_is_the_plan() -> None:
    volume = VoxelVolume(np.array([[0.0, 0, 0], [3.0, 3, 2.5]]))
    volume.state[:] = FREE
    volume.state[5, 5, -2] = OCCUPIED  # above the agent
    assert free_plan(volume, np.array([1.0, 1.0, 1.25])).all()
    assert free_plan(volume, volume.center_of(np.array([5, 5, 0]))).all()  # in the lowest layer
