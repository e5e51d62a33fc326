"""Rays against meshes whose answers are known in closed form."""

from __future__ import annotations

import multiprocessing
import pickle
import sys

import numpy as np
import pytest

from activestructure_gym.scenes.raycaster import RayCaster


def _box_distance(origins: np.ndarray, directions: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Ray parameter at which a ray from inside leaves the box [0, size]: the nearest of the three exit planes."""
    with np.errstate(divide="ignore"):
        planes = np.where(directions > 0, (size - origins) / directions, -origins / directions)
    return planes.min(axis=1)


def test_distances_in_a_box_match_the_closed_form(make_box, rng):
    size = np.array([4.0, 3.0, 2.5])
    caster = RayCaster(*make_box((0, 0, 0), size))
    origins = rng.uniform(0.1, 0.9, (20_000, 3)) * size
    directions = rng.normal(size=(20_000, 3))  # lengths differ: the parameter is in units of each
    hits = caster.cast(origins, directions)
    given = (array.astype(np.float32).astype(np.float64) for array in (origins, directions))
    expected = _box_distance(*given, size)
    assert (hits.face >= 0).all()
    # float32 positions up to 4 m: 1e-5 m along the ray.
    length = np.linalg.norm(directions, axis=1)
    np.testing.assert_allclose(hits.distance * length, expected * length, atol=1e-5)


def test_barycentric_coordinates_give_the_hit_point(make_box, rng):
    vertices, faces = make_box((0, 0, 0), (4, 3, 2.5))
    caster = RayCaster(vertices, faces)
    origin, directions = np.array([1.0, 1.0, 1.0]), rng.normal(size=(500, 3))
    hits = caster.cast(origin, directions)
    a, b, c = (vertices[faces[hits.face, k]] for k in range(3))
    on_face = a + hits.u[:, None] * (b - a) + hits.v[:, None] * (c - a)
    np.testing.assert_allclose(on_face, origin + hits.distance[:, None] * directions, atol=1e-5)


def test_a_ray_that_meets_nothing_has_infinite_distance_and_no_face(make_box):
    caster = RayCaster(*make_box((0, 0, 0), (1, 1, 1)))
    hits = caster.cast(np.array([[2.0, 0.5, 0.5]]), np.array([[1.0, 0.0, 0.0]]))
    assert np.isinf(hits.distance[0]) and hits.face[0] == -1
    assert len(caster.cast(np.zeros((0, 3)), np.zeros((0, 3))).distance) == 0


def test_a_segment_may_end_on_a_surface_but_not_pass_it(make_box):
    caster = RayCaster(*make_box((0, 0, 0), (1, 1, 1)))
    start = np.array([0.5, 0.5, 0.5])
    ends = np.array([[0.5, 0.5, 1.0], [0.5, 0.5, 0.9], [0.5, 0.5, 1.01]])
    assert caster.occluded(start, ends).tolist() == [False, False, True]


def test_a_copy_from_another_process_and_two_threads_answer_alike(make_box, rng):
    caster = RayCaster(*make_box((0, 0, 0), (4, 3, 2.5)), threads=2)
    single = RayCaster(*make_box((0, 0, 0), (4, 3, 2.5)), threads=1)
    directions = rng.normal(size=(40_000, 3))  # enough for both threads to get a share
    expected = single.cast(np.array([1.0, 1.0, 1.0]), directions).distance
    np.testing.assert_array_equal(caster.cast(np.array([1.0, 1.0, 1.0]), directions).distance, expected)
    copy = pickle.loads(pickle.dumps(caster))
    np.testing.assert_array_equal(copy.cast(np.array([1.0, 1.0, 1.0]), directions).distance, expected)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux forks")
def test_a_forked_child_casts_after_its_parent_used_two_threads(make_box, rng):
    caster = RayCaster(*make_box((0, 0, 0), (4, 3, 2.5)))
    directions = rng.normal(size=(30_000, 3))
    here = caster.cast(np.ones(3), directions).distance  # starts the parent's threads
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=lambda: sender.send(caster.cast(np.ones(3), directions).distance))
    child.start()
    try:
        assert receiver.poll(30), "the forked child hangs"
        np.testing.assert_array_equal(receiver.recv(), here)
    finally:
        child.kill()
        child.join()


@pytest.mark.parametrize("center", [0.0, 1000.0])
def test_rays_through_vertices_meet_a_closed_mesh(center):
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=5, radius=3.0)
    vertices = (sphere.vertices + center).astype(np.float32)
    caster = RayCaster(vertices, sphere.faces)
    hits = caster.cast(np.full(3, center), vertices.astype(np.float64) - center)
    assert (hits.face >= 0).all() and np.isfinite([hits.u, hits.v]).all()
    np.testing.assert_allclose(hits.distance, 1.0, atol=2e-4 if center else 1e-5)


def test_rays_past_the_edge_of_an_open_mesh_stay_misses():
    floor = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    caster = RayCaster(floor, np.array([[0, 1, 2], [0, 2, 3]]))
    past = np.array([[1.0 + 5e-7, 0.5, 1.0], [-5e-7, 0.5, 1.0], [0.5, 1.0 + 5e-7, 1.0], [3.0, 3.0, 1.0]])
    hits = caster.cast(past, np.tile([0.0, 0.0, -1.0], (4, 1)))
    assert (hits.face == -1).all() and np.isinf(hits.distance).all()
