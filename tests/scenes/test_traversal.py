"""Hits of the ray caster against brute force in float64, and on rays with known answers."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.scenes import load_scene
from activestructure_gym.scenes.hierarchy import LEAF_BITS, build_hierarchy
from activestructure_gym.scenes.raycaster import RayCaster


def brute_force(vertices, faces, origins, directions) -> np.ndarray:  # [N, F] float64, inf for a miss
    """The distances at which each ray meets each triangle, by Moeller and Trumbore in float64."""
    a, b, c = (np.asarray(vertices, np.float32)[faces[:, k]].astype(np.float64) for k in range(3))
    origins, directions = (np.asarray(array, np.float32).astype(np.float64) for array in (origins, directions))
    along = np.full((len(directions), len(faces)), np.inf)
    for n, (origin, direction) in enumerate(zip(origins, directions)):
        across = np.cross(direction, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1.0 / ((b - a) * across).sum(axis=1)
            u = ((origin - a) * across).sum(axis=1) * scale
            turned = np.cross(origin - a, b - a)
            v = turned @ direction * scale
            t = ((c - a) * turned).sum(axis=1) * scale
            meets = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0)
        along[n, meets] = t[meets]
    return along


def random_rays(rng, vertices, count, kind="random"):
    """Rays that begin in the middle of a mesh's bounding box."""
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    origins = (lower + (upper - lower) * rng.uniform(0.05, 0.95, (count, 3))).astype(np.float32)
    if kind == "axes":
        directions = np.eye(3)[rng.integers(0, 3, count)] * rng.choice([-1.0, 1.0], (count, 1))
    else:
        directions = rng.normal(size=(count, 3))
    return origins, directions.astype(np.float32)


# --- Against brute force


@pytest.mark.parametrize("kind", ["random", "axes"])
@pytest.mark.parametrize("count", [1, 2, 7, 300])
def test_first_hits_of_a_soup_are_those_of_brute_force(rng, count, kind):
    centers = rng.uniform(-1, 1, (count, 1, 3))
    vertices = (centers + rng.normal(scale=0.3, size=(count, 3, 3))).reshape(-1, 3).astype(np.float32)
    faces = rng.permutation(3 * count).reshape(-1, 3)
    origins, directions = random_rays(rng, vertices, 1000, kind)
    along = brute_force(vertices, faces, origins, directions)
    caster = RayCaster(vertices, faces)
    hits = caster.cast(origins, directions)
    missed = np.isinf(along.min(axis=1))
    assert missed.any() and not missed.all()
    np.testing.assert_array_equal(hits.face, np.where(missed, -1, along.argmin(axis=1)))
    np.testing.assert_allclose(hits.distance, along.min(axis=1), rtol=1e-6)
    blocked = caster.occluded(origins, origins + directions, margin=0.0)
    ends = (origins + directions) - origins  # as `occluded` rounds them
    np.testing.assert_array_equal(blocked, brute_force(vertices, faces, origins, ends).min(axis=1) <= 1.0)


def test_of_faces_at_one_distance_the_lowest_is_hit(rng):
    vertices = rng.normal(size=(30, 3)).astype(np.float32)
    faces = np.tile(rng.permutation(30).reshape(-1, 3), (20, 1))  # each of ten triangles twenty times
    origins, directions = random_rays(rng, vertices, 500)
    along = brute_force(vertices, faces, origins, directions)
    hits = RayCaster(vertices, faces).cast(origins, directions)
    np.testing.assert_array_equal(hits.face, np.where(np.isinf(along.min(axis=1)), -1, along.argmin(axis=1)))


@pytest.mark.parametrize("name", ["bookstore", "garage", "home_theater", "hotel_room"])
def test_first_hits_in_real_scenes_are_those_of_brute_force(rng, shared, name):
    mesh = load_scene(f"{shared / 'scenes' / name}.glb?up=z").mesh
    for kind in ("random", "axes"):
        origins, directions = random_rays(rng, mesh.vertices, 100, kind)
        along = brute_force(mesh.vertices, mesh.faces, origins, directions).min(axis=1)
        hits = RayCaster(mesh.vertices, mesh.faces).cast(origins, directions)
        np.testing.assert_array_equal(hits.face >= 0, np.isfinite(along))
        np.testing.assert_allclose(hits.distance, along, rtol=1e-6)


# --- Rays with known answers

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32), np.array([[0, 1, 2]])


def test_one_triangle_with_its_edges_and_both_sides():
    caster = RayCaster(*TRIANGLE)
    eyes = np.array([[0.2, 0.3, 1], [0.2, 0.3, -1], [0.5, 0, 1], [0, 0.5, 1], [0.5, 0.5, 1], [0, 0, 1], [0.2, 0.3, 0]])
    toward = np.array([[0, 0, -2], [0, 0, 1], *[[0, 0, -1]] * 5])
    hits = caster.cast(eyes, toward)
    assert hits.face.tolist() == [0] * 7
    np.testing.assert_allclose(hits.distance, [0.5, 1, 1, 1, 1, 1, 0], atol=1e-6)
    np.testing.assert_allclose(hits.u, eyes[:, 0], atol=1e-6)
    np.testing.assert_allclose(hits.v, eyes[:, 1], atol=1e-6)


def test_misses_have_no_face_and_no_place():
    caster = RayCaster(*TRIANGLE)
    eyes = np.array([[0.2, 0.3, 1], [0.2, 0.3, 1], [-1, 0.2, 0], [0.6, 0.6, 1], [0.2, 0.3, 1], [0.2, 0.3, 1]])
    # away, without length, in the triangle's plane, past an edge, not a number, infinite
    toward = np.array([[0, 0, 1], [0, 0, 0], [1, 0, 0], [0, 0, -1], [np.nan, 0, -1], [0, 0, -np.inf]])
    hits = caster.cast(eyes, toward)
    assert np.isinf(hits.distance).all() and (hits.face == -1).all() and not hits.u.any() and not hits.v.any()


def test_no_rays_and_no_triangles():
    none = np.zeros((0, 3))
    caster = RayCaster(*TRIANGLE)
    assert len(caster.cast(none, none).face) == 0 and len(caster.occluded(none, none)) == 0
    empty = RayCaster(none, none.astype(int))
    assert empty.cast(np.ones((1, 3)), np.ones((1, 3))).face.tolist() == [-1]
    assert not empty.occluded(np.zeros((1, 3)), np.ones((1, 3))).any()


def test_triangles_without_area_are_never_hit_and_hide_nothing(make_box, rng):
    vertices, faces = make_box((0, 0, 0), (2, 2, 2))
    lines = np.array([[0, 0, 7], [3, 3, 3], [1, 1, 4]])
    whole = RayCaster(vertices, faces)
    caster = RayCaster(vertices, np.concatenate([lines, faces]))
    directions = rng.normal(size=(2000, 3))
    hits, expected = caster.cast(np.ones(3), directions), whole.cast(np.ones(3), directions)
    np.testing.assert_array_equal(hits.face, expected.face + len(lines))
    np.testing.assert_array_equal(hits.distance, expected.distance)


@pytest.mark.parametrize("center", [0.0, 1000.0])
def test_no_ray_leaves_a_closed_mesh_through_an_edge_or_a_vertex(center):
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=4, radius=3.0)
    vertices = (sphere.vertices + center).astype(np.float32)
    middles = vertices[sphere.edges_unique].astype(np.float64).mean(axis=1)
    caster = RayCaster(vertices, sphere.faces)
    for targets in (vertices, middles):
        hits = caster.cast(np.full(3, center), targets - np.full(3, center))
        assert (hits.face >= 0).all()
        np.testing.assert_allclose(hits.distance, 1.0, atol=1e-3)


def test_rays_along_the_axes_through_the_corners_and_edges_of_a_grid():
    """Boxes of the hierarchy are flat here, and the rays run in the planes of their sides."""
    x, y = np.meshgrid(np.arange(9.0), np.arange(9.0), indexing="ij")
    vertices = np.column_stack([x.ravel(), y.ravel(), np.zeros(81)]).astype(np.float32)
    first = (9 * np.arange(8)[:, None] + np.arange(8)).ravel()
    quads = np.column_stack([first, first + 9, first + 1, first + 1, first + 9, first + 10])
    faces = quads.reshape(-1, 3)
    steps = np.arange(1, 16) / 2.0  # inside: corners, edges and diagonals
    eyes = np.stack([*np.meshgrid(steps, steps), np.full((15, 15), 2.0)], axis=-1).reshape(-1, 3)
    hits = RayCaster(vertices, faces).cast(eyes, np.tile([0.0, 0.0, -1.0], (len(eyes), 1)))
    assert (hits.face >= 0).all()
    np.testing.assert_allclose(hits.distance, 2.0, atol=1e-6)
    a, b, c = (vertices[faces[hits.face, k]] for k in range(3))
    met = a + hits.u[:, None] * (b - a) + hits.v[:, None] * (c - a)
    np.testing.assert_allclose(met[:, :2], eyes[:, :2], atol=1e-6)


# --- The hierarchy


def test_the_hierarchy_is_complete_and_its_boxes_hold_what_is_below(rng):
    vertices = rng.normal(size=(3000, 3)).astype(np.float32)
    vertices[600:] = vertices[600]  # no cut separates these
    faces = np.arange(3000).reshape(-1, 3)
    boxes, children, corners, order = build_hierarchy(vertices, faces)
    np.testing.assert_array_equal(np.sort(order), np.arange(1000))
    np.testing.assert_array_equal(corners, vertices[faces[order]].reshape(-1, 9))
    seen = list[int]()

    def check(node: int) -> None:
        for which in (0, 1) if node else (0,):
            below, box = children[node, which], boxes[node, which]
            if below < 0:
                first, count = ~below >> LEAF_BITS, (~below & (1 << LEAF_BITS) - 1) + 1
                points = corners[first : first + count].reshape(-1, 3)
                np.testing.assert_array_equal(box, [*points.min(axis=0), *points.max(axis=0)])
                seen.extend(range(first, first + count))
            else:
                inside = boxes[below]
                np.testing.assert_array_equal(box, [*inside[:, :3].min(axis=0), *inside[:, 3:].max(axis=0)])
                check(below)

    check(0)
    assert sorted(seen) == list(range(1000))


def test_sizes_over_fifty_orders_of_magnitude_are_hit():
    """A cut by area takes off one triangle at a time here, so that the hierarchy would be as deep as there are."""
    sizes = 16.0 ** np.arange(-30, 13)
    shape = np.array([[1.0, 0.0, 0.0], [1.1, 0.0, 0.0], [1.0, 0.1, 0.0]])
    vertices, eye = (sizes[:, None, None] * shape).reshape(-1, 3), np.array([1.03, 0.03, 1.0])
    caster = RayCaster(vertices, np.arange(len(vertices)).reshape(-1, 3))
    hits = caster.cast(sizes[:, None] * eye, np.tile([0.0, 0.0, -1.0], (len(sizes), 1)))
    np.testing.assert_array_equal(hits.face, np.arange(len(sizes)))
    np.testing.assert_allclose(hits.distance, sizes, rtol=1e-6)
