"""Nodes, way and horizon on a plan drawn by hand: two rooms of 4 x 4 m and a door."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from activestructure_gym.features import FeatureContext, evaluate_features
from activestructure_gym.features.in_horizon import departed, last_moved, lines_free
from activestructure_gym.features.voronoi_node import NODE_REACH, floor_graph
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.volume import FREE, OCCUPIED, VolumeConfig, VoxelVolume

CAMERA = PinholeCamera.from_size(40, 24)
BOUNDS = np.array([[0.0, 0, 0], [8.2, 4, 2.5]])
START = np.array([2.0, 2.0, 1.25])
X = np.array([1.0, 0.0, 0.0])


def frame(position: np.ndarray, direction: np.ndarray = X, depth: float = 2.0) -> SimpleNamespace:
    image = np.full((CAMERA.height, CAMERA.width), depth, np.float32)
    return SimpleNamespace(world_from_camera=look_along(position, direction), camera=CAMERA, depth=image)


def context(positions: list, frames: list | None = None, *, door: bool = True) -> FeatureContext:
    volume = VoxelVolume(BOUNDS, VolumeConfig())
    volume.state[:] = OCCUPIED
    volume.state[1:41, 1:41, 1:26] = volume.state[43:83, 1:41, 1:26] = FREE
    if door:
        volume.state[41:43, 17:25, 1:21] = FREE
    volume._changed()
    return FeatureContext(
        mapper=SimpleNamespace(keyframes=frames or [frame(START)]),
        volume=volume, planes=None, camera=CAMERA, bounds=BOUNDS, coverage_alpha=0.5, max_range=10.0,
        world_from_camera=np.stack([look_along(np.array(p, float), X) for p in positions]),
    )  # fmt: skip


def column(name: str, ctx: FeatureContext) -> np.ndarray:  # [K]
    return evaluate_features((name,), ctx)[:, 0]


def test_views_stand_for_the_node_they_are_near_at_any_height() -> None:
    ctx = context([[2.1, 1.9, 0.6], [2.1, 2.1, 2.0], [6.2, 2.0, 1.25], [0.5, 0.5, 1.25]])
    nodes = ctx.once(floor_graph).nodes
    np.testing.assert_allclose(nodes, [[2.0, 2.0], [6.2, 2.0]], atol=0.2)
    np.testing.assert_array_equal(column("voronoi_node", ctx), [0, 0, 1, -1])
    sides = [[nodes[0][0] + NODE_REACH + d, nodes[0][1], 1.25] for d in (-0.01, 0.01)]
    np.testing.assert_array_equal(column("voronoi_node", context(sides)), [0, -1])


def test_without_a_door_the_other_room_has_no_node() -> None:
    assert len(context([[2.0, 2.0, 1.25]], door=False).once(floor_graph)) == 1
    np.testing.assert_array_equal(
        column("voronoi_node", context([[2.0, 2.0, 1.2], [6.2, 2.0, 1.2]], door=False)), [0, -1]
    )


def test_where_the_start_is_not_free_there_is_no_node() -> None:
    ctx = context([[2.0, 2.0, 1.25]], [frame(np.array([4.15, 0.5, 1.25]))])
    np.testing.assert_array_equal(column("voronoi_node", ctx), [-1])
    np.testing.assert_allclose(column("visited_distance", ctx), np.hypot(2.15, 1.5), rtol=1e-6)


def test_visited_distance_is_from_the_node_to_the_nearest_keyframe() -> None:
    ctx = context([[1.9, 1.9, 2.0], [0.5, 0.5, 0.7]], [frame(START), frame(np.array([0.5, 1.5, 1.25]))])
    node = ctx.once(floor_graph).nodes[0]
    expected = [np.linalg.norm(node - START[:2]), 1.0]  # the second has no node: from where it is
    np.testing.assert_allclose(column("visited_distance", ctx), expected, rtol=1e-5)


PLACES = [[3.0, 3.0, 1.25], [3.6, 3.0, 1.25], [1.0, 2.0, 1.25], [7.5, 2.0, 1.25], [7.5, 3.6, 1.25], [2.1, 2.0, 1.25]]
WEST = START - [0.4, 0.0, 0.0]


def test_in_horizon_needs_a_free_way_and_the_box_of_a_frame() -> None:
    # A wall 1.5 m ahead: the frustum is 3 m wide there, from y = 0.5 to 3.5. The last place stands for a node.
    near = column("in_horizon", context(PLACES, [frame(WEST, depth=1.5)]))
    np.testing.assert_array_equal(near, [1, 0, 0, 0, 0, 1])
    # Through the door one sees the second room; what stands beside the door is behind a wall.
    far = column("in_horizon", context(PLACES, [frame(WEST, depth=6.0)]))
    np.testing.assert_array_equal(far, [1, 1, 0, 1, 0, 1])


def test_the_box_is_that_of_the_place_it_left_wherever_it_looked_since() -> None:
    before = WEST - [0.5, 0.0, 0.0]
    start = frame(before, depth=2.0)  # a box up to x = 3.1
    way = frame(before + [0.25, 0.0, 0.0], depth=6.0)
    looks = [frame(before, -X), start, way, frame(WEST, depth=6.0), frame(WEST, -X), frame(WEST + [0.04, 0.0, 0.0], -X)]
    assert departed(looks) is start and last_moved(looks) is looks[3]
    np.testing.assert_array_equal(column("in_horizon", context(PLACES, looks)), [1, 0, 0, 0, 0, 1])
    assert departed(looks[2:4]) is way
    assert departed(looks[:1]) is last_moved(looks[:1]) is looks[0]
    assert departed(looks[4:]) is last_moved(looks[4:]) is looks[5]  # it never moved


def test_a_line_over_a_table_is_not_free_on_the_plan() -> None:
    ctx = context(PLACES, [frame(WEST, depth=6.0)])
    np.testing.assert_array_equal(column("in_horizon", ctx), [1, 1, 0, 1, 0, 1])
    low = context(PLACES, [frame(WEST, depth=6.0)])
    low.volume.state[26:29, 20:31, 1:8] = OCCUPIED  # 0.7 m high, under the camera and beside the way to the door
    low.volume._changed()
    np.testing.assert_array_equal(column("in_horizon", low)[:2], [0, 0])


def test_lines_on_a_plan_by_hand() -> None:
    plan = np.ones((6, 4), dtype=bool)
    plan[3, 1] = plan[0, 0] = False
    ends = np.array([[5.5, 0.5], [5.5, 1.5], [5.5, 2.5], [6.5, 0.5], [1.5, 3.9]])
    start = np.array([0.5, 0.5])
    assert lines_free(plan, start, ends, 0.9).tolist() == [True, False, False, False, True]
    assert not lines_free(plan, start, ends, 0.0).any()  # the cell below the agent counts


def test_without_a_node_in_the_box_all_free_ways_count() -> None:
    # Looking west from beside the node: what is behind is in no box, but in sight.
    turned = column("in_horizon", context(PLACES, [frame(WEST, -X)]))
    np.testing.assert_array_equal(turned, [1, 1, 1, 1, 0, 1])
