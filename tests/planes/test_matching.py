"""One surface, one node; two surfaces, two nodes."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.planes import MatchingConfig

LOOKS = [((0.0, y, 1.5), (1.0, 0.0, 0.0)) for y in (-1.0, 0.0, 1.0)]


def watch(graph, scene, looks, **options):
    for position, direction in looks:
        graph.update(scene.shoot(position, direction, **options)[0])
    return graph


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_two_fragments_of_one_wall_become_one_node(rectangles, new_graph, noise, rng):
    # Two pieces 1.4 m apart, never in one image: the centroids are 2.6 m apart.
    scene = rectangles().add((2, -2, 0.5), (0, 1.2, 0), (0, 0, 2)).add((2, 0.6, 0.5), (0, 1.2, 0), (0, 0, 2))
    looks = [((1.0, -1.4, 1.5), (1, 0, 0)), ((1.0, 1.2, 1.5), (1, 0, 0))]
    graph = watch(new_graph(noise), scene, looks, noise=noise, rng=rng)
    (node,) = graph.nodes
    assert node.observations == 2
    assert node.area == pytest.approx(2 * 1.2 * 1.0, rel=0.3)  # at 1 m the image is 1.1 m high


def test_fragments_in_one_image_become_one_node(rectangles, new_graph):
    scene = rectangles().add((2, -1.5, 0.5), (0, 1, 0), (0, 0, 2)).add((2, 0.5, 0.5), (0, 1, 0), (0, 0, 2))
    (node,) = watch(new_graph(), scene, LOOKS).nodes
    assert node.observations == 3  # keyframes, not segments


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_parallel_walls_never_merge(rectangles, new_graph, noise, rng):
    """0.6 m apart, seen from every side of the front one's edge, at full noise."""
    scene = rectangles().add((2, -2, 0), (0, 2, 0), (0, 0, 3)).add((2.6, -1, 0), (0, 3, 0), (0, 0, 3))
    looks = [((0.3, y, z), (1.0, d, 0.0)) for y in (-1.0, 0.0, 1.0) for z in (1.0, 2.0) for d in (-0.4, 0.0, 0.4)]
    graph = watch(new_graph(noise), scene, looks, noise=noise, rng=rng)
    assert len(graph.nodes) == 2
    assert sorted(-node.offset * np.sign(node.normal[0]) for node in graph.nodes) == pytest.approx([2.0, 2.6], abs=0.02)


def test_the_faces_of_a_thin_wall_stay_two(rectangles, new_graph):
    scene = rectangles().box((2, -1, 0), (2.08, 1, 2.5))
    looks = [((0.5, 0, 1.2), (1, 0, 0)), ((3.58, 0, 1.2), (-1, 0, 0))] * 3
    graph = watch(new_graph(), scene, looks)
    assert len(graph.nodes) == 2
    assert graph.state.normals[0] @ graph.state.normals[1] == pytest.approx(-1.0, abs=1e-6)


def test_a_step_of_twelve_centimetres_is_two_planes(rectangles, new_graph):
    scene = rectangles().add((2, -1.5, 0), (0, 1.5, 0), (0, 0, 3)).add((2.12, 0, 0), (0, 1.5, 0), (0, 0, 3))
    assert len(watch(new_graph(), scene, LOOKS).nodes) == 2


def test_a_jump_in_depth_forbids_what_the_planes_allow(rectangles, new_graph):
    """A shelf 7 cm in front of a wall lies within the near mode's 10 cm; with a gate of 5 cm on depth it is apart."""
    from dataclasses import replace

    from activestructure_gym.planes import PlaneSceneGraph

    scene = rectangles().add((2.0, -0.4, 1.0), (0, 0.8, 0), (0, 0, 0.8))
    looks = [((0.5, 0, 1.4), (1, 0, 0))]
    behind = rectangles().add((2.07, -0.4, 1.0), (0, 0.8, 0), (0, 0, 0.8))
    for gap, count in ((0.10, 1), (0.05, 2)):
        config = replace(new_graph().config, matching=MatchingConfig(depth_gap=gap))
        graph = PlaneSceneGraph(config)
        watch(graph, scene, looks)
        watch(graph, behind, looks)
        assert len(graph.nodes) == count


def test_a_long_floor_is_one_node_although_its_ends_are_far_apart(rectangles, new_graph):
    scene = rectangles().add((0, -1, 0), (14, 0, 0), (0, 2, 0))
    looks = [((x, 0, 1.2), (1, 0, -0.8)) for x in np.arange(0.5, 12.0, 1.5)]
    (node,) = watch(new_graph(), scene, looks).nodes
    assert node.area > 20.0


def test_nodes_that_turn_out_to_be_one_surface_merge(rectangles, new_graph):
    """Two ends of a floor 8 m apart are two nodes until the middle is seen."""
    scene = rectangles().add((0, -1, 0), (10, 0, 0), (0, 2, 0))
    graph = new_graph()
    watch(graph, scene, [((0.5, 0, 1.2), (1, 0, -2.0)), ((9.5, 0, 1.2), (-1, 0, -2.0))])
    assert [node.id for node in graph.nodes] == [0, 1]
    watch(graph, scene, [((x, 0, 1.2), (1, 0, -1.0)) for x in (2.0, 3.5, 5.0, 6.5)])
    (node,) = graph.nodes
    assert node.id == 0  # the older name stays
    assert node.observations == 6


def test_bad_configuration_is_refused():
    with pytest.raises(ValueError, match="near_reach must be a number from 0 to 1000"):
        MatchingConfig(near_reach=-1.0)
