import itertools

import networkx as nx
import numpy as np
import pytest

from activestructure_gym.motion import first_blocked_edge, path_lengths
from activestructure_gym.motion.reachability import _moves, _spread
from activestructure_gym.volume import OCCUPIED, VoxelVolume

BOUNDS = np.array([[0.0, 0.0, 0.0], [6.0, 4.0, 2.5]])


WALL = [(3.0, -1.0, -1.0), (3.2, 5.0, 9.0)]
WALL_WITH_DOOR = [((3.0, -1.0, -1.0), (3.2, 1.5, 9.0)), ((3.0, 2.4, -1.0), (3.2, 5.0, 9.0))]


def grid_graph(open_):
    """The 26-neighbour graph of the open voxels, diagonals only through open blocks, written plainly."""
    graph = nx.Graph()
    for cell in map(tuple, np.argwhere(open_)):
        graph.add_node(cell)
        for move in itertools.product((-1, 0, 1), repeat=3):
            block = [tuple(np.add(cell, np.multiply(move, part))) for part in itertools.product((0, 1), repeat=3)]
            if any(move) and all(open_[voxel] for voxel in block):
                graph.add_edge(cell, tuple(np.add(cell, move)), weight=float(np.linalg.norm(move)))
    return graph


@pytest.mark.parametrize("share", [0.95, 0.7, 0.5])
def test_lengths_equal_networkx_on_random_grids(share):
    rng = np.random.default_rng(int(share * 100))
    open_ = np.pad(rng.random((9, 8, 7)) < share, 1)
    cells = np.argwhere(open_)
    seeds = cells[rng.choice(len(cells), 3, replace=False)]
    lengths = np.full(open_.shape, np.inf, np.float32)
    parents = np.full(open_.shape, -1, np.int32)
    offsets = np.array([0.3, 2.6, 1.1], np.float32)
    lengths[tuple(seeds.T)] = offsets
    flat = np.ravel_multi_index(tuple(seeds.T), open_.shape)
    _spread(open_.ravel(), lengths.ravel(), parents.ravel(), flat, *_moves(open_.shape))
    graph = grid_graph(open_)
    for seed, offset in zip(seeds, offsets):
        graph.add_edge("start", tuple(seed), weight=float(offset))
    oracle = nx.single_source_dijkstra_path_length(graph, "start")
    for cell in map(tuple, cells):
        assert lengths[cell] == pytest.approx(oracle.get(cell, np.inf), abs=1e-4)
    assert np.isinf(lengths[~open_]).all()


def test_straight_line_in_free_space_is_exact_and_the_grid_within_ten_percent(free_volume):
    volume, rng = free_volume(), np.random.default_rng(0)
    start = np.array([0.8, 0.9, 1.2])
    points = rng.uniform(BOUNDS[0] + 0.35, BOUNDS[1] - 0.35, size=(300, 3))
    distances = path_lengths(volume, start, min_clearance=0.2)
    straight = np.linalg.norm(points - start, axis=1)
    np.testing.assert_allclose(distances.at(points), straight, rtol=1e-5, atol=1e-5)
    for point, length in zip(points[:50], straight[:50]):
        path = distances.path_to(point)
        along = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
        # 26 directions: at worst 10.3 % too long [arc between (1,0,0), (1,1,0), (1,1,1)], plus the way onto the grid.
        assert length - 1e-6 <= along <= 1.104 * length + 0.2


def test_lengths_are_symmetric(free_volume):
    volume, rng = free_volume(*WALL_WITH_DOOR), np.random.default_rng(1)
    points = volume.center_of(volume.voxel_of(rng.uniform(BOUNDS[0] + 0.4, BOUNDS[1] - 0.4, size=(8, 3))))
    lengths = np.stack([path_lengths(volume, p, min_clearance=0.2).at(points) for p in points])
    assert np.isfinite(lengths).sum() > 30
    np.testing.assert_allclose(lengths, lengths.T, rtol=1e-5, atol=1e-5)


def test_a_closed_wall_cannot_be_passed_and_a_door_can(free_volume):
    here, there = np.array([1.0, 2.0, 1.2]), np.array([5.0, 2.0, 1.2])
    closed = path_lengths(free_volume(WALL), here, min_clearance=0.2)
    assert np.isinf(closed.at(there)[0]) and closed.path_to(there) is None
    assert (closed.reachable[:, 0] < 3.0).all()
    door = free_volume(*WALL_WITH_DOOR)
    # The door is 0.9 m wide: passable with 0.2 m on each side, not with 0.5 m.
    assert path_lengths(door, here, min_clearance=0.2).at(there)[0] == pytest.approx(4.0, abs=0.01)
    assert np.isinf(path_lengths(door, here, min_clearance=0.5).at(there)[0])


def test_every_edge_of_a_path_keeps_the_clearance(free_volume):
    rng = np.random.default_rng(2)
    volume = free_volume(*WALL_WITH_DOOR, *[(c, c + 0.4) for c in rng.uniform([0, 0, 0], [5.5, 3.5, 2.0], (12, 3))])
    start = volume.center_of(np.argwhere(volume.clearance > 0.3)[500]) + 0.02
    distances = path_lengths(volume, start, min_clearance=0.2)
    points = rng.uniform(BOUNDS[0], BOUNDS[1], size=(400, 3))
    lengths = distances.at(points)
    assert 50 < np.isfinite(lengths).sum() < 400
    for point, length in zip(points, lengths):
        path = distances.path_to(point)
        assert (path is None) == np.isinf(length)
        if path is not None:
            np.testing.assert_array_equal(path[[0, -1]], [start, point])
            assert first_blocked_edge(volume, path, min_clearance=0.2) is None
            assert volume.segments_free(path[:-1], path[1:], min_clearance=0.2, step=0.01).mean() > 0.9


def test_a_start_in_a_tight_place_leaves_it_straight(free_volume):
    volume = free_volume(WALL)
    start, goal = np.array([2.9, 2.05, 1.25]), np.array([1.0, 2.0, 1.2])  # 0.1 m from the wall
    assert 0.05 < volume.clearance_at(start[None])[0] < 0.2
    path = path_lengths(volume, start, min_clearance=0.2).path_to(goal)
    assert path is not None and volume.clearance_at(path[1:2])[0] >= 0.2
    assert np.linalg.norm(path[1] - path[0]) < 0.3
    assert first_blocked_edge(volume, path, min_clearance=0.2) is None
    # The exception is for leaving only: the way back into the tight place is refused, and so is walking along in it.
    assert first_blocked_edge(volume, path[::-1], min_clearance=0.2) is not None
    along = np.array([[2.9, 2.05, 1.25], [2.9, 3.2, 1.25]])
    assert first_blocked_edge(volume, along, min_clearance=0.2) == 0
    buried = np.array([3.1, 2.0, 1.2])
    assert len(path_lengths(volume, buried, min_clearance=0.2).reachable) == 0


def test_a_start_without_free_space_reaches_nothing_but_itself():
    start = np.array([1.0, 1.0, 1.0])
    distances = path_lengths(VoxelVolume(BOUNDS), start, min_clearance=0.2)
    assert distances.at(np.array([start, [1.0, 1.0, 1.01], [99.0, 0.0, 0.0]])).tolist() == [0.0, np.inf, np.inf]
    np.testing.assert_array_equal(distances.path_to(start), start[None])
    assert distances.path_to(np.array([1.0, 1.0, 1.01])) is None
    assert distances.at(np.zeros((0, 3))).shape == (0,)


def test_a_map_stays_valid_when_the_volume_changes(free_volume):
    volume = free_volume()
    distances = path_lengths(volume, np.array([1.0, 2.0, 1.2]), min_clearance=0.2)
    goal = np.array([[5.0, 2.0, 1.2]])
    before = distances.at(goal)
    volume.state[:] = OCCUPIED
    volume.mark_free_sphere(np.array([1.0, 2.0, 1.2]), 0.3)
    np.testing.assert_array_equal(distances.at(goal), before)
