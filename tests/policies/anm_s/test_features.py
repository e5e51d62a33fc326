"""What ANM-S and ActiveINR are told about every candidate, with surfaces drawn by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from activestructure_gym.features import FeatureContext, evaluate_features
from activestructure_gym.features.uncertain_surface import Surface, by_proxy
from activestructure_gym.features.voronoi_node import floor_graph
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.motion import VoronoiGraph
from activestructure_gym.policies.activeinr.features import CEILING, FOOT_M, free, preferred
from activestructure_gym.policies.anm_s.features import count_views
from activestructure_gym.volume import FREE, OCCUPIED, VolumeConfig, VoxelVolume

X, Y, Z = np.eye(3)
BOUNDS = np.array([[0.0, 0, 0], [10.0, 4, 3]])


def keyframe(world_from_camera: np.ndarray, seen: np.ndarray = BOUNDS) -> SimpleNamespace:
    """A keyframe with two depth returns, at the corners ``seen`` [2, 3] of a box."""
    rotation, position = world_from_camera[:3, :3], world_from_camera[:3, 3]
    camera = SimpleNamespace(backproject=lambda depth: (seen - position) @ rotation)
    return SimpleNamespace(world_from_camera=world_from_camera, camera=camera, depth=np.ones(2))


def context(poses: list[tuple], surface: Surface, nodes: list | None = None, **graph: list) -> FeatureContext:
    """Candidates (position, direction); the agent stands at (1, 2, 1.5); surface and graph as given."""
    volume = VoxelVolume(BOUNDS, VolumeConfig())
    volume.state[:] = FREE
    here = look_along(np.array([1.0, 2.0, 1.5]), X)
    made = FeatureContext(
        mapper=SimpleNamespace(keyframes=[keyframe(here)]), volume=volume, planes=None,
        camera=PinholeCamera.from_size(40, 24), bounds=BOUNDS, coverage_alpha=0.5, max_range=10.0,
        world_from_camera=np.stack([look_along(np.array(p, float), np.array(d, float)) for p, d in poses]),
    )  # fmt: skip
    made._results[floor_graph] = graph_of(nodes or [], **graph)
    made._results[by_proxy] = surface
    return made


def graph_of(nodes: list, **graph: list) -> VoronoiGraph:
    return VoronoiGraph(
        np.reshape(nodes, (-1, 2)).astype(float), np.ones(len(nodes)), np.zeros((0, 2), np.int64), np.zeros(0),
        np.reshape(graph.get("ends", []), (-1, 2)).astype(float), np.array(graph.get("of", []), np.int64),
    )  # fmt: skip


def patches(*places: tuple[tuple, np.ndarray, int, float]) -> Surface:
    """Rows of voxels along y: (first point, normal, how many, uncertainty)."""
    points, normals, values = [], [], []
    for first, normal, count, value in places:
        points += [np.array(first) + 0.1 * k * Y for k in range(count)]
        normals += [normal] * count
        values += [value] * count
    voxels = np.round(np.array(points) / 0.1).astype(np.int64)
    return Surface(voxels, np.array(points), np.array(normals), np.array(values))


def columns(ctx: FeatureContext, *names: str) -> np.ndarray:  # [K, G]
    return evaluate_features(names, ctx)


SURE = ((0.0, 0.0, 0.0), X, 40, 0.0)  # of no cluster of ANM-S: four fifths of the surface


def test_clusters_belong_to_the_node_nearest_to_their_target() -> None:
    # Two patches, at x = 9 (seen from x < 9) and at y = 3.8 near node 0. Their targets are (8.5, 2) and (2, 3.3).
    surface = patches(SURE, ((9.0, 1.8, 0.5), -X, 5, 1.0), ((2.0, 3.6, 0.5), -Y, 5, 1.0))
    poses = [((2.3, 2, 1.5), Y), ((2.3, 2, 1.5), X), ((8, 2, 1.5), X), ((5, 2, 1.5), X)]
    ctx = context(poses, surface, nodes=[[2.0, 2.0], [8.0, 2.0]])
    table = columns(ctx, "anm_s_proxy_clusters", "anm_s_proxy_looks", "anm_s_proxy_facing")
    np.testing.assert_array_equal(table[:, 0], [1, 1, 1, 0])  # the last stands for no node
    np.testing.assert_array_equal(table[:, 1], [1, 1, 1, 0])
    # Directions are level, however low the patch, and lead to the target (-0.3, 1.3), not to the patch (-0.3, 1.8).
    length = np.hypot(0.3, 1.3)
    np.testing.assert_allclose(table[:, 2], [1.3 / length, -0.3 / length, 1.0, -1.0], atol=1e-6)


def test_surface_above_the_head_has_no_clusters() -> None:
    # The camera starts at 1.5 m, so the head is at 1.75 m. The more uncertain patch at 1.8 m is left out.
    low, high = ((2.0, 3.0, 1.7), -Y, 10, 1.0), ((9.0, 1.8, 1.8), -X, 10, 2.0)
    poses = [((2, 2, 1.5), Y), ((8, 2, 1.5), X)]
    ctx = context(poses, patches(SURE, low, high), nodes=[[2.0, 2.0], [8.0, 2.0]])
    np.testing.assert_array_equal(columns(ctx, "anm_s_proxy_clusters")[:, 0], [1, 0])


def test_ends_of_cut_chains_are_looked_at_if_the_node_has_a_cluster() -> None:
    nothing = patches(SURE)
    poses = [((2, 2, 0.7), X), ((2, 2, 0.7), -X), ((8, 2, 1.5), X)]
    ctx = context(poses, nothing, nodes=[[2.0, 2.0], [8.0, 2.0]], ends=[[0.5, 2.0], [9.5, 2.0]], of=[0, 1])
    # All is equally sure, so the first fifth is one cluster, at the corner below node 0.
    table = columns(ctx, "anm_s_proxy_clusters", "anm_s_proxy_looks", "anm_s_proxy_facing")
    np.testing.assert_array_equal(table[2], [0, 0, -1])
    np.testing.assert_array_equal(table[:2, 0], [1, 1])
    assert table[1, 2] == 1.0  # level, whatever the height


def test_the_horizon_is_ahead_of_the_last_movement_wherever_the_camera_turned() -> None:
    """From (1.4, 2) along x, half of 24 rows over 20 pixels see the floor from 1.5 * 20 / 12 = 2.5 m to the wall."""
    places = [(4.5, 2, 1.5), (0.5, 2, 1.5), (2.5, 2, 1.5), (8, 2, 1.5)]
    ctx = context([(p, X) for p in places], patches(SURE), nodes=[p[:2] for p in places])
    ctx.volume.state[:, :, 0] = ctx.volume.state[50:52] = OCCUPIED  # the floor, and a wall at x = 5
    ctx.volume._changed()
    moved, turned = (keyframe(look_along(np.array([1.4, 2.0, 1.5]), d), np.array([[0.0, 1, 0], [1.4, 3, 3]]))
                     for d in (-X, Y))  # fmt: skip
    ctx.mapper.keyframes += [moved, turned]
    np.testing.assert_array_equal(columns(ctx, "anm_s_horizon")[:, 0], [1, 0, 0, 0])
    ctx = replace(ctx, world_from_camera=ctx.world_from_camera[1:])
    # Nothing ahead is a node any more: all in line of sight count.
    ctx._results[floor_graph] = graph_of([p[:2] for p in places[1:]])
    np.testing.assert_array_equal(columns(ctx, "anm_s_horizon")[:, 0], [1, 1, 0])


def test_the_horizon_reaches_as_far_as_the_sensor() -> None:
    ctx = context([((8, 2, 1.5), X), ((0.5, 2, 1.5), X)], patches(SURE), nodes=[(8, 2), (0.5, 2)])
    ctx.volume.state[:, :, 0] = ctx.volume.state[92:] = OCCUPIED  # the floor, and a wall at x = 9.1, 7.7 m ahead
    ctx.volume._changed()
    ctx.mapper.keyframes.append(keyframe(look_along(np.array([1.4, 2.0, 1.5]), X)))
    np.testing.assert_array_equal(columns(ctx, "anm_s_horizon")[:, 0], [1, 0])
    short = replace(ctx, max_range=5.0)  # no node in the box, so all free lines count
    np.testing.assert_array_equal(columns(short, "anm_s_horizon")[:, 0], [1, 1])


def test_before_a_movement_the_horizon_is_that_of_the_depth_returns() -> None:
    ctx = context([((2, 2, 1.5), X), ((8, 2, 1.5), X)], patches(SURE), nodes=[(2, 2), (8, 2)])
    ctx.mapper.keyframes[0] = keyframe(look_along(np.array([1.0, 2.0, 1.5]), X), np.array([[2.0, 1, 0], [4, 3, 3]]))
    np.testing.assert_array_equal(columns(ctx, "anm_s_horizon")[:, 0], [1, 0])


def test_an_end_of_a_chain_at_the_candidate_itself_needs_no_look() -> None:
    ctx = context([((2, 2, 1.5), X)], patches(SURE), nodes=[(2, 2)], ends=[(2, 2), (4, 2)], of=[0, 0])
    np.testing.assert_allclose(columns(ctx, "anm_s_proxy"), [[1, 2, 1]])  # the corner below, and the other end


def test_directions_within_45_degrees_take_one_look() -> None:
    turns = np.radians([0.0, 20.0, 44.0, 46.0, 180.0])
    ways = np.stack([np.cos(turns), np.sin(turns), np.zeros(5)], axis=1)
    assert count_views(ways) == 3
    assert count_views(ways[:0]) == 0
    assert count_views(np.concatenate([np.eye(3), -np.eye(3)])) == 6


def test_a_cluster_stands_with_the_candidate_at_its_target_that_looks_at_it() -> None:
    surface = patches(((9.0, 1.8, 1.5), -X, 5, 1.0), ((5.0, 1.9, 0.0), Z, 3, 0.5))
    poses = [
        ((8.5, 2, 1.5), -X),  # at the target of the larger cluster, but looking away
        ((8.4, 2, 1.5), X),  # nearly there, looking at it
        ((5, 2, 1.0), -Z),  # half a metre above the target of the smaller one
        ((5, 2, 1.0), Z),
    ]
    table = columns(context(poses, surface), *(f"activeinr_proxy{axis}" for axis in ("", "_x", "_y", "_z")))
    # Four fifths of 8, rounded up, are 7: all of the first and 2 of the second.
    np.testing.assert_allclose(table[:, 0], [0, 5 / 8, 2 / 8, 0])
    np.testing.assert_allclose(table[1, 1:], [8.5, 2.0, 1.5], atol=1e-6)
    np.testing.assert_allclose(table[2, 1:], [5.0, 1.95, 0.5], atol=1e-6)
    np.testing.assert_allclose(table[0, 1:], [8.5, 2.0, 1.5])  # none: its own place


def test_targets_that_are_not_free_or_too_near_or_outside_come_last() -> None:
    wall, agent = ((9.0, 1.8, 1.5), -X, 5, 1.0), ((1.0, 1.8, 2.0), -Z, 5, 1.0)
    outside = ((0.2, 1.8, 1.5), -X, 5, 1.0)
    poses = [((8.5, 2, 1.5), X), ((1.0, 2, 1.5), Z), ((0.3, 2, 1.5), X)]
    ctx = context(poses, patches(wall, agent, outside, ((5.0, 0.1, 0.0), Z, 3, 0.0)))
    assert (columns(ctx, "activeinr_proxy")[:, 0] > 0).tolist() == [True, False, False]
    # Each wish counts as far as anything is left: what is free and far is outside then, and taken all the same.
    ctx = context(poses, patches(wall, agent, outside, ((5.0, 0.1, 0.0), Z, 3, 0.0)))
    ctx.volume.state[80:90] = OCCUPIED
    assert (columns(ctx, "activeinr_proxy")[:, 0] > 0).tolist() == [False, False, True]


def test_targets_that_the_newest_keyframe_does_not_surround_come_last() -> None:
    behind, ahead = ((0.5, 3.4, 1.5), X, 5, 1.0), ((9.0, 1.8, 1.5), -X, 3, 1.0)
    ctx = context([((1, 3.6, 1.5), -X), ((8.5, 2, 1.5), X)], patches(behind, ahead))
    ctx.mapper.keyframes[-1] = keyframe(look_along(np.array([1.0, 2.0, 1.5]), X), np.array([[2.0, 0, 0], [10, 4, 3]]))
    assert (columns(ctx, "activeinr_proxy")[:, 0] > 0).tolist() == [False, True]


def test_on_wheels_a_target_has_the_height_of_the_camera_and_room_for_the_body_below_it() -> None:
    table, wall = ((5.0, 1.8, 0.8), Z, 5, 1.0), ((9.0, 1.8, 1.0), -X, 3, 1.0)
    level, flying = [((5, 2, 1.5), X), ((8.5, 2, 1.5), X)], [((5, 2, 1.3), X), ((8.5, 2, 1.5), X)]
    for poses, shares, heights in ((level, [0, 2 / 8], [1.5, 1.5]), (flying, [5 / 8, 2 / 8], [1.3, 1.0])):
        ctx = context(poses, patches(table, wall))
        ctx.volume.state[50:53, 18:24, 7:9] = OCCUPIED  # the target is above it
        found = columns(ctx, "activeinr_proxy")[:, [0, 3]]
        np.testing.assert_allclose(found, np.column_stack([shares, heights]), atol=1e-6)


@pytest.mark.parametrize(("height", "blocked"), [(0.35, False), (0.45, True), (1.2, True)])
def test_the_body_on_wheels_begins_40_cm_above_the_floor(height: float, blocked: bool) -> None:
    """The camera is 1.25 m above the floor, so the body has 0.85 m; voxels are 0.1 m high."""
    volume = VoxelVolume(np.array([[0.0, 0.0, 0.0], [2.0, 2.0, 2.5]]))
    volume.state[:, :, volume.voxel_of(np.array([1.0, 1.0, height]))[2]] = OCCUPIED
    assert free(volume, np.array([[1.0, 1.0, 1.25]]), FOOT_M).tolist() == [not blocked]


def test_wishes_that_nothing_fulfils_are_dropped_one_by_one() -> None:
    first, second, third = np.array([[1, 1, 0], [0, 0, 1], [1, 0, 1]], dtype=bool)
    assert preferred(first, second, third).tolist() == [True, False, False]
    assert preferred(second, first, third).tolist() == [False, False, True]
    assert preferred(~first & first, second).tolist() == [False, False, True]
    assert preferred(np.zeros(2, bool), np.zeros(2, bool)).tolist() == [True, True]


def test_no_cluster_stands_with_a_revisit_or_is_lost_to_a_larger_one() -> None:
    surface = patches(((9.0, 1.8, 1.5), -X, 5, 1.0), ((9.0, 1.8, 1.0), -X, 3, 1.0), ((5.0, 0.0, 0.0), Z, 2, 0.0))
    poses = [((8.5, 2, 1.25), X), ((8.0, 2, 1.25), X), ((7.0, 2, 1.25), X), ((2.0, 2, 1.25), X)]
    assert columns(context(poses, surface), "activeinr_proxy")[:, 0].tolist() == pytest.approx([0.5, 0.3, 0, 0])
    ctx = context(poses, surface)
    ctx.mapper.keyframes.insert(0, SimpleNamespace(world_from_camera=ctx.world_from_camera[0]))
    assert ctx.revisits.tolist() == [True, False, False, False]
    assert columns(ctx, "activeinr_proxy")[:, 0].tolist() == pytest.approx([0, 0.5, 0.3, 0])
    assert (columns(context(poses[:1], surface), "activeinr_proxy")[:, 0] > 0).all()  # fewer views than clusters


def test_the_ceiling_is_no_cluster_of_activeinr_and_joins_none() -> None:
    top = BOUNDS[1, 2] - CEILING
    poses = [((5, 2, 1.0), X), ((5, 2, 1.0), -X)]
    high = patches(((5.0, 1.8, top), -Z, 5, 1.0), ((9.0, 1.8, 1.5), -X, 3, 1.0))
    assert columns(context(poses, high), "activeinr_proxy")[:, 0].tolist() == [1.0, 0.0]


def test_without_a_surface_there_is_nothing_to_look_at() -> None:
    empty = Surface(np.zeros((0, 3), np.int64), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    ctx = context([((2, 2, 1.5), X)], empty, nodes=[[2.0, 2.0]])
    table = columns(ctx, "anm_s_proxy_clusters", "anm_s_proxy_looks", "anm_s_proxy_facing", "activeinr_proxy")
    np.testing.assert_array_equal(table[:, :4], [[0, 0, -1, 0]])
