"""The Plane Scene Graph as a whole: it converges, moves rigidly, repeats itself, survives anything."""

from __future__ import annotations

import pickle
from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from activestructure_gym.geometry.frame import Frame
from activestructure_gym.planes import PlaneGraphConfig, PlaneSceneGraph
from activestructure_gym.planes.detection import PlaneSegment
from activestructure_gym.planes.graph import tangent_axes
from activestructure_gym.planes.nodes import PlaneNode
from activestructure_gym.planes.surface import Patch
from activestructure_gym.planes.surface_kernels import COVERED


def wander(room, rng, count, *, low, high, pitch=(-0.6, 0.6), **options):
    """Frames from random places of a room in random directions."""
    for _ in range(count):
        angle = rng.uniform(0, 2 * np.pi)
        direction = (np.cos(angle), np.sin(angle), rng.uniform(*pitch))
        yield room.shoot(rng.uniform(low, high), direction, rng=rng, **options)[0]


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_a_closed_room_has_six_nodes_and_keeps_them(box_room, new_graph, rng, noise):
    graph = new_graph(noise)
    counts = []
    for frame in wander(box_room, rng, 120, low=(0.5, 0.5, 0.5), high=(3.8, 2.6, 2.0), noise=noise):
        graph.update(frame)
        counts.append(len(graph.nodes))
    assert counts[20:] == [6] * 100
    # Its areas are those of the room, and it is whole.
    expected = np.sort([4.3 * 3.1, 4.3 * 3.1, 4.3 * 2.5, 4.3 * 2.5, 3.1 * 2.5, 3.1 * 2.5])
    np.testing.assert_allclose(np.sort(graph.state.areas), expected, rtol=0.03)
    assert (graph.state.quality.modes[:, [0, 3, 4, 5, 7]] > 0.9).all()
    assert len(graph.deficiencies) == 0
    assert graph.state.structural.all()
    assert graph.state.tree.sum() == 2 * 5


def test_a_furnished_room_has_its_planes(furnished_room, furnished_views, new_graph):
    """Six sides of the room and the large faces of furniture, each found within a degree and a centimetre."""
    graph = new_graph()
    for position, direction in furnished_views:
        graph.update(furnished_room.shoot(position, direction)[0])
    sides = [furnished_room.plane(k) for k in range(6)]
    faces = {"table": 7, "cupboard": 10}  # nodes more or less are small faces of furniture
    assert 6 + len(faces) <= len(graph.nodes) <= 30
    for normal, d in sides:
        near = (np.abs(graph.state.normals @ normal) > np.cos(np.radians(1.0))) & (
            np.abs(np.abs(graph.state.offsets) - abs(d)) < 0.01
        )
        assert near.any()


def test_a_rigid_motion_of_everything_changes_nothing(furnished_room, furnished_views, new_graph, rng):
    frames = [furnished_room.shoot(p, d, noise=1.0, rng=rng)[0] for p, d in furnished_views[:14]]
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec([0.7, -1.1, 0.4]).as_matrix()
    motion[:3, 3] = [11.0, -7.0, 3.0]

    def space(points):  # some rule in the room's own frame
        return (np.floor(points * 4.0).astype(int).sum(axis=1) % 3).astype(np.uint8)

    def moved_space(points):
        return space((points - motion[:3, 3]) @ motion[:3, :3])

    here, there = new_graph(1.0), new_graph(1.0)
    for frame in frames:
        here.update(frame, space_state=space)
        there.update(replace(frame, world_from_camera=motion @ frame.world_from_camera), space_state=moved_space)
    assert len(here.nodes) == len(there.nodes) > 8
    np.testing.assert_allclose(there.state.normals, here.state.normals @ motion[:3, :3].T, atol=1e-9)
    centroids = here.state.centroids @ motion[:3, :3].T + motion[:3, 3]
    np.testing.assert_allclose(there.state.centroids, centroids, atol=1e-9)
    np.testing.assert_allclose(there.state.weights, here.state.weights, atol=1e-9)
    np.testing.assert_array_equal(there.state.edges, here.state.edges)
    np.testing.assert_array_equal(there.state.tree, here.state.tree)
    np.testing.assert_array_equal(there.state.structural, here.state.structural)
    np.testing.assert_allclose(there.state.quality.modes, here.state.quality.modes, atol=1e-6)
    np.testing.assert_allclose(there.state.surprise.total, here.state.surprise.total, atol=1e-6)
    np.testing.assert_allclose(there.state.deficit, here.state.deficit, atol=1e-6)
    np.testing.assert_allclose(
        there.deficiencies.centres, here.deficiencies.centres @ motion[:3, :3].T + motion[:3, 3], atol=1e-6
    )


def test_the_same_frames_give_the_same_graph(furnished_room, furnished_views, new_graph):
    frames = [furnished_room.shoot(p, d)[0] for p, d in furnished_views[:8]]
    first, second = new_graph(), new_graph()
    for k, frame in enumerate(frames):
        first.update(frame)
        second.update(frame)
        if k == 3:
            second = pickle.loads(pickle.dumps(second))
    np.testing.assert_array_equal(first.state.quality.modes, second.state.quality.modes)
    np.testing.assert_array_equal(first.state.deficit, second.state.deficit)
    np.testing.assert_array_equal(first.deficiencies.centres, second.deficiencies.centres)
    assert [node.id for node in first.nodes] == [node.id for node in second.nodes]


def test_assessed_once_after_several_keyframes_it_is_as_if_after_each(furnished_room, furnished_views, new_graph):
    each, once = new_graph(), new_graph()
    for position, direction in furnished_views[:8]:
        frame = furnished_room.shoot(position, direction)[0]
        each.update(frame)
        once.integrate(frame)
    assert once.nodes and len(once.state.areas) == 0  # as of the last assessment
    once.assess()
    for name in ("normals", "offsets", "areas", "weights", "edges", "tree", "betweenness", "structural", "deficit"):
        np.testing.assert_array_equal(getattr(once.state, name), getattr(each.state, name))
    np.testing.assert_array_equal(once.state.quality.modes, each.state.quality.modes)
    np.testing.assert_array_equal(once.deficiencies.centres, each.deficiencies.centres)


def test_edges_need_a_common_keyframe(rectangles, new_graph):
    """Two boards side by side, never in one image: near each other, yet their relation was never observed."""
    scene = rectangles().add((2, -1.1, 1), (0.2, 1.0, 0), (0, 0, 1)).add((2, 0.1, 1), (-0.2, 1.0, 0), (0, 0, 1))
    graph = new_graph()
    graph.update(scene.shoot((1.4, -0.7, 1.5), (1, 0, 0))[0])
    graph.update(scene.shoot((1.4, 0.7, 1.5), (1, 0, 0))[0])
    assert len(graph.nodes) == 2 and not graph.state.edges.any()
    assert graph.state.weights[0, 1] < 0.5
    np.testing.assert_allclose(graph.state.surprise.connectivity, 1.0)
    np.testing.assert_allclose(graph.state.surprise.neighbourhood, [1.0, 1.0], atol=1e-6)
    before = graph.state.deficit.copy()
    graph.update(scene.shoot((0.0, 0.0, 1.5), (1, 0, 0))[0])
    assert graph.state.edges[0, 1] and graph.state.tree[0, 1]
    np.testing.assert_allclose(graph.state.surprise.neighbourhood, [0.1, 0.1], atol=1e-6)
    assert (graph.state.deficit < before).all()


def test_networkx_view_is_the_graph(furnished_room, furnished_views, new_graph):
    graph = new_graph()
    for position, direction in furnished_views[:10]:
        graph.update(furnished_room.shoot(position, direction)[0])
    view = graph.as_networkx()
    assert list(view.nodes) == [node.id for node in graph.nodes]
    assert view.number_of_edges() == graph.state.edges.sum() // 2
    forest = nx.minimum_spanning_tree(view)
    total = sum(d["weight"] for _, _, d in view.edges(data=True) if d["tree"])
    assert total == pytest.approx(sum(d["weight"] for _, _, d in forest.edges(data=True)))
    tree_only = nx.Graph()
    tree_only.add_nodes_from(view)
    tree_only.add_edges_from((a, b) for a, b, d in view.edges(data=True) if d["tree"])
    expected = nx.betweenness_centrality(tree_only)
    for k, node in enumerate(graph.nodes):
        assert view.nodes[node.id]["betweenness"] == pytest.approx(expected[node.id])
        assert view.nodes[node.id]["deficit"] == graph.state.deficit[k]
        assert len(view.nodes[node.id]["points"]) == graph.state.point_counts[k]


def test_points_lie_on_the_surface_they_come_from(box_room, new_graph, rng):
    graph = new_graph()
    for frame in wander(box_room, rng, 20, low=(0.5, 0.5, 0.5), high=(3.8, 2.6, 2.0)):
        graph.update(frame)
    points, exists = graph.sample_points(64)
    assert points.shape == (len(graph.nodes), 64, 3) and exists.all()
    outside = np.maximum(-points, points - [4.3, 3.1, 2.5]).max(axis=-1)
    assert outside.max() < 0.05  # a cell
    for k in range(len(graph.nodes)):
        np.testing.assert_allclose(points[k] @ graph.state.normals[k] + graph.state.offsets[k], 0.0, atol=1e-9)
        assert np.abs(np.minimum(np.abs(points[k]), np.abs(points[k] - [4.3, 3.1, 2.5])).min(axis=1)).max() < 0.02


def test_nothing_seen_is_an_empty_graph(rectangles):
    graph = PlaneSceneGraph()
    frame, _ = rectangles().add((50, 0, 0), (0, 1, 0), (0, 0, 1)).shoot((0, 0, 0), (1, 0, 0))
    graph.update(frame)
    assert graph.nodes == [] and graph.keyframes == 1
    assert graph.state.weights.shape == (0, 0) and graph.state.normals.shape == (0, 3)
    assert graph.as_networkx().number_of_nodes() == 0
    with pytest.raises(KeyError):
        graph.node(0)


def test_wild_depth_never_raises(new_graph, rng):
    """Noise, stripes, slivers, single planes through the camera's axis: whatever comes, the numbers stay finite."""
    from activestructure_gym.geometry import PinholeCamera, look_along

    camera = PinholeCamera.from_size(64, 48)
    graph = PlaneSceneGraph(replace(new_graph().config, min_node_area=0.0))
    v, u = np.mgrid[0:48, 0:64]
    images = [
        rng.uniform(0.1, 5.0, (48, 64)),
        np.where(u % 8 < 4, 2.0, 0.0),
        np.where(v < 4, 0.05, 0.0),
        np.full((48, 64), 1e-3),
        1.0 / (0.2 + 0.05 * np.abs(u - 32)),
        np.where(rng.uniform(size=(48, 64)) < 0.3, 0.0, 1.5),
    ]
    for k in range(24):
        pose = look_along(rng.uniform(-1, 1, 3), rng.standard_normal(3))
        depth = images[k % len(images)].astype(np.float32)
        graph.update(Frame(np.zeros((48, 64, 3), np.uint8), depth, pose, camera))
        state = graph.state
        for array in (state.quality.modes, state.surprise.total, state.deficit, state.weights, state.centroids):
            assert np.isfinite(array).all()
        assert ((state.quality.modes >= 0) & (state.quality.modes <= 1)).all()
        assert all(len(node.points) for node in graph.nodes)
        graph.arrays(16)
    assert len(graph.nodes) > 1


def test_small_segments_found_no_node_but_join_one(rectangles):
    small = rectangles().add((1, -0.1, 1.4), (0, 0.2, 0), (0, 0, 0.2))  # 0.04 m^2
    graph = PlaneSceneGraph()
    graph.update(small.shoot((0, 0, 1.5), (1, 0, 0))[0])
    assert graph.nodes == []
    wall = rectangles().add((1, -1, 1), (0, 2, 0), (0, 0, 1))
    graph.update(wall.shoot((0, 0, 1.5), (1, 0, 0))[0])
    graph.update(small.shoot((0, 0, 1.5), (1, 0, 0))[0])
    assert [node.observations for node in graph.nodes] == [2]


def test_planes_are_fused_by_a_moving_average(rectangles, new_graph):
    """The same board again, turned by 4 deg about its middle: the node moves by 0.3 of it, then by 0.3 of the rest."""
    graph = new_graph()
    t = np.radians(4.0)
    straight = rectangles().add((2, -0.6, 1.1), (0, 1.2, 0), (0, 0, 0.8))
    along = 1.2 * np.array([np.sin(t), np.cos(t), 0.0])
    turned = rectangles().add(np.array([2, 0, 1.1]) - along / 2, along, (0, 0, 0.8))
    graph.update(straight.shoot((0, 0, 1.5), (1, 0, 0))[0])
    for expected in (1.2, 2.04):
        graph.update(turned.shoot((0, 0, 1.5), (1, 0, 0))[0])
        (node,) = graph.nodes
        assert np.degrees(np.arccos(abs(node.normal[0]))) == pytest.approx(expected, abs=0.06)


def test_a_glimpse_does_not_turn_a_wall(rectangles, new_graph):
    """A scrap of 0.25 m^2, 7 deg off, is believed to be part of an 8 m^2 wall; the wall moves by its share."""
    wall = rectangles().add((2, -2, 0), (0, 4, 0), (0, 0, 2))
    graph = new_graph()
    for y in (-1.0, 0.0, 1.0):
        graph.update(wall.shoot((0, y, 1), (1, 0, 0))[0])
    t = np.radians(7.0)
    scrap = rectangles().add((1.97, 0, 0.75), (0.5 * np.sin(t), 0.5 * np.cos(t), 0), (0, 0, 0.5))
    graph.update(scrap.shoot((1, 0.2, 1), (1, 0, 0))[0])
    (node,) = graph.nodes
    assert node.observations == 4
    assert np.degrees(np.arccos(abs(node.normal[0]))) < 0.1  # 0.3 of 7 deg would be 2.1


def test_tangent_axes_follow_the_long_side_and_the_image(rng):
    from activestructure_gym.planes import PlaneSegment

    long_side = rng.uniform(-1, 1, (200, 2)) * [2.0, 0.5]
    turn = Rotation.from_rotvec([0.3, 0.2, 0.9]).as_matrix()
    points = np.column_stack([long_side, np.zeros(200)]) @ turn.T
    normal = turn[:, 2]
    segment = PlaneSegment(normal, 0.0, points.mean(axis=0), 1.0, 0.0, 200, points, 0)
    for sign in (1.0, -1.0):
        axes = tangent_axes(segment, sign * turn[:, 0])
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(axes) == pytest.approx(1.0)
        np.testing.assert_allclose(axes[2], normal)
        assert sign * axes[0] @ turn[:, 0] > 0.99


def test_bad_configuration_is_refused():
    for bad in ({"cell": 0.0}, {"fusion_rate": 1.5}, {"normal_window": 0}, {"min_node_area": -1.0}):
        with pytest.raises(ValueError, match=next(iter(bad))):
            PlaneGraphConfig(**bad)


def test_a_merged_plane_keeps_one_normal_per_keyframe_the_last_ones() -> None:
    def node(number: int, area: float, seen: dict[int, tuple[float, float, float]]) -> PlaneNode:
        points = np.zeros((4, 3))
        segment = PlaneSegment(np.array([0.0, 0, 1]), 0.0, points[0], area, 0.0, len(points), points, 0)
        made = PlaneNode(number, segment, np.eye(3), cell=0.05, window=3)
        shown = np.ones((2, round(area / (2 * 0.05**2))), np.int32)
        made.surface.add(Patch(np.zeros(2, np.int64), shown, 0 * shown, shown, np.zeros(shown.shape, np.uint8)))
        for keyframe, normal in seen.items():
            made.normals[keyframe] = np.array(normal)
            made.keyframes |= 1 << keyframe
        return made

    kept = node(0, 0.03, {0: (1.0, 0, 0), 4: (0, 1.0, 0), 7: (0, 0, 1.0)})
    kept.absorb(node(1, 0.01, {3: (1.0, 0, 0), 4: (0, 0, 1.0), 5: (0, 1.0, 0)}))
    assert list(kept.normals) == [4, 5, 7] and kept.observations == 5
    np.testing.assert_allclose(kept.normals[4], np.array([0, 3.0, 1.0]) / np.sqrt(10))  # by area
    np.testing.assert_array_equal(kept.normals[5], [0, 1.0, 0])
    np.testing.assert_array_equal(kept.normals[7], [0, 0, 1.0])


def test_pixels_that_the_detection_leaves_out_are_no_votes_against_a_plane(rectangles, new_graph):
    hall = rectangles().box((-6, -6, 0), (6, 6, 2.7))
    graph = new_graph()
    for k in range(3):
        graph.update(hall.shoot((3 + 0.05 * k, 3, 1.2), (1, 1, -0.5))[0])
    (floor,) = (node for node in graph.nodes if node.normal[2] > 0.9)
    near = floor.surface.points()
    for k in range(8):  # the same floor from farther away, partly beyond the depth and the incidence of the detection
        graph.update(hall.shoot((-1 + 0.05 * k, 2, 1.2), (1, 0.3, -0.2))[0])
    assert floor.area > 30.0 and floor.surface.contains(near).mean() > 0.995  # it was 0.69


def test_an_object_without_a_segment_still_covers_the_plane_behind_it(rectangles, new_graph):
    # A post of 4 cm, 3 cm before the wall, is narrower than a block of the detection, so it has no segment.
    scene = rectangles().box((0, 0, 0), (4, 3, 2.5)).box((3.93, 1.48, 0.0), (3.97, 1.52, 2.5))
    graph = new_graph()
    for k in range(3):
        graph.update(scene.shoot((1.0, 1.4 + 0.01 * k, 1.2), (1, 0, 0), size=(320, 180))[0])
    wall = next(node for node in graph.nodes if node.normal[0] < -0.9 and node.area > 1.0).surface
    rows, columns = np.nonzero(wall.seen >= 0)
    _, y, z = wall.cell_centres(rows, columns).T
    behind = (abs(y - 1.51) < 0.015) & (z > 0.5) & (z < 2.0)  # seen from y = 1.4, the post hides y of 1.49 to 1.54
    assert behind.sum() > 10 and wall.seen[rows[behind], columns[behind]].mean() < 0.1  # at the image's edge
    assert (wall.beside[rows[behind], columns[behind]] == COVERED).mean() > 0.9
