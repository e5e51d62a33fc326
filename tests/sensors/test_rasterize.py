"""Images drawn triangle by triangle: against ray casting, closed forms, and for holes between triangles."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.scenes.scene import Scene
from activestructure_gym.sensors import make_renderer, raycast
from activestructure_gym.sensors.raycast import RaycastRenderer
from activestructure_gym.sensors.renderer import LARGE
from tests.sensors.test_raycast import box_depth

CAMERA = PinholeCamera.from_size(64, 37)


def poses(rng: np.random.Generator, low: list[float], high: list[float], count: int) -> np.ndarray:
    directions = rng.normal(size=(count, 3)) * [1, 1, 0.6]
    return np.stack([look_along(rng.uniform(low, high), direction) for direction in directions])


@pytest.mark.parametrize("supersample", [1, 2, 3])
def test_hits_are_those_of_ray_casting(cluttered_room, room_poses, supersample) -> None:
    drawn, cast = RaycastRenderer(cluttered_room, draws_from=0), RaycastRenderer(cluttered_room)
    other, steps = 0, []
    for pose in room_poses:
        (rgb, depth), (true_rgb, true_depth) = (r.render(CAMERA, pose, supersample=supersample) for r in (drawn, cast))
        other += np.count_nonzero(np.abs(depth - true_depth) > 1e-5)
        steps.append(np.abs(rgb.astype(int) - true_rgb).max(axis=-1).ravel())
    assert other <= 2 and (np.concatenate(steps) > 1).sum() <= 2


def test_depth_of_the_box_room_is_exact_and_without_holes(box_room) -> None:
    """From within, also very near to a wall, where triangles reach behind the camera."""
    renderer, rng = RaycastRenderer(box_room, draws_from=0), np.random.default_rng(0)
    near, far = poses(rng, [0.001, 0.5, 0.5], [0.01, 2.5, 2.0], 20), poses(rng, [0.1] * 3, [3.9, 2.9, 2.4], 40)
    for pose in (*near, *far):
        depth = renderer.render(CAMERA, pose, supersample=1)[1]
        np.testing.assert_allclose(depth, box_depth(CAMERA, pose, (4.0, 3.0, 2.5)), rtol=1e-5, atol=1e-6)


def test_no_sample_falls_between_small_triangles(make_quad, merge) -> None:
    """A wall of 100 x 100 jittered cells and thin slivers, seen at a slant."""
    rng = np.random.default_rng(1)
    grid = np.stack(np.meshgrid(np.linspace(-9, 9, 101), np.linspace(-9, 9, 101), indexing="ij"), axis=-1)
    grid[1:-1, 1:-1] += rng.uniform(-0.085, 0.085, (99, 99, 2))
    vertices = np.concatenate([grid.reshape(-1, 2), np.full((101 * 101, 1), 2.0)], axis=1).astype(np.float32)
    corner = (np.arange(100)[:, None] * 101 + np.arange(100)).ravel()
    faces = np.concatenate([corner[:, None] + [0, 1, 102], corner[:, None] + [0, 102, 101]]).astype(np.int32)
    mesh = merge([make_quad([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], (1, 1, 1), np.zeros((4, 2)), -1)])
    zeros = np.zeros((len(vertices), 3), np.float32)
    mesh = dataclasses.replace(
        mesh,
        vertices=vertices,
        faces=faces,
        colors=zeros,
        uv=zeros[:, :2],
        face_texture=np.full(len(faces), -1, np.int32),
    )
    renderer = RaycastRenderer(Scene("wall", mesh, "tests"), draws_from=0)
    for direction in ([0, 0, 1], [0.3, 0.1, 1], [-0.2, 0.5, 1]):
        pose = look_along(np.array([0.01, 0.02, 0.0]), np.array(direction, float))
        depth = renderer.render(PinholeCamera.from_size(400, 300), pose, supersample=1)[1]
        assert (depth > 0).all()


def test_the_nearer_of_two_triangles_is_seen_from_both_sides(make_quad, merge) -> None:
    far = [[-9, -9, 2], [9, -9, 2], [9, 9, 2], [-9, 9, 2]]
    near = [[0, 9, 1], [9, 9, 1], [9, -9, 1], [0, -9, 1]]  # turned the other way
    quads = [make_quad(near, (1, 0, 0), np.zeros((4, 2)), -1), make_quad(far, (0, 1, 0), np.zeros((4, 2)), -1)]
    for mesh in (merge(quads), merge(quads[::-1])):
        scene = Scene("two", mesh, "tests")
        rgb, depth = RaycastRenderer(scene, draws_from=0).render(
            PinholeCamera.from_size(8, 6), np.eye(4), supersample=2
        )
        assert depth[:, :4] == pytest.approx(2.0) and depth[:, 4:] == pytest.approx(1.0)
        assert (rgb[:, :4] == [0, 255, 0]).all() and (rgb[:, 4:] == [255, 0, 0]).all()


@pytest.mark.parametrize("draws_from", [0, None])
@pytest.mark.parametrize("tilt", [0.0, 0.3])
def test_of_walls_in_one_plane_each_side_sees_its_own(make_quad, merge, draws_from, tilt) -> None:
    # As two rooms have them: a red wall seen from z < 2, a green one with other corners seen from z > 2.
    def wall(left: float, right: float, *, back: bool) -> list[list[float]]:
        corners = [[left, -9.0, 2.0 + tilt * left], [right, -9.0, 2.0 + tilt * right]]
        corners += [[right, 9.0, 2.0 + tilt * right], [left, 9.0, 2.0 + tilt * left]]
        return corners if back else corners[::-1]

    red = make_quad(wall(-5.0, 5.1, back=False), (1, 0, 0), np.zeros((4, 2)), -1)
    green = make_quad(wall(-4.7, 5.3, back=True), (0, 1, 0), np.zeros((4, 2)), -1)
    behind = np.diag([1.0, -1.0, -1.0, 1.0])
    behind[:3, 3] = 0.1, 0.2, 4.1
    for mesh in (merge([red, green]), merge([green, red])):
        renderer = RaycastRenderer(Scene("walls", mesh, "tests"), draws_from=draws_from)
        for pose, color in ((np.eye(4), [255, 0, 0]), (behind, [0, 255, 0])):
            rgb, _ = renderer.render(PinholeCamera.from_size(96, 54), pose, supersample=2)
            assert (rgb == color).all()


@pytest.mark.parametrize("draws_from", [0, None])
def test_of_faces_in_one_plane_the_first_is_seen(make_quad, merge, draws_from) -> None:
    places = [(-5.0, 5.1), (-4.7, 5.3)]
    quads = [
        make_quad([[b, -9, 2], [a, -9, 2], [a, 9, 2], [b, 9, 2]], color, np.zeros((4, 2)), -1)
        for (a, b), color in zip(places, ((1, 0, 0), (0, 1, 0)))
    ]
    for mesh, color in ((merge(quads), [255, 0, 0]), (merge(quads[::-1]), [0, 255, 0])):
        renderer = RaycastRenderer(Scene("walls", mesh, "tests"), draws_from=draws_from)
        rgb, _ = renderer.render(PinholeCamera.from_size(96, 54), np.eye(4), supersample=2)
        assert (rgb == color).all()


def test_the_result_depends_neither_on_threads_nor_bands_nor_colour_samples(cluttered_room, room_poses, monkeypatch):
    expected = RaycastRenderer(cluttered_room, threads=1, draws_from=0).render(CAMERA, room_poses[1], supersample=2)
    renderer = pickle.loads(pickle.dumps(RaycastRenderer(cluttered_room, threads=3, draws_from=0)))
    for rays in (1, 16_000, 10**9):
        monkeypatch.setattr(raycast, "_RAYS_PER_BAND", rays)
        for got, want in zip(renderer.render(CAMERA, room_poses[1], supersample=2), expected):
            np.testing.assert_array_equal(got, want)
    for supersample in (1, 3, 4):
        depth = renderer.render(CAMERA, room_poses[1], supersample=supersample)[1]
        np.testing.assert_array_equal(depth, expected[1])


def test_nothing_ahead_is_black_with_depth_0(box_room) -> None:
    outside = np.eye(4)
    outside[:3, 3] = (0, 0, 50)
    rgb, depth = RaycastRenderer(box_room, draws_from=0).render(CAMERA, outside)
    assert not rgb.any() and not depth.any()


def test_auto_draws_large_images_of_meshes_with_few_triangles_per_ray(box_room, monkeypatch) -> None:
    sizes: list[int] = []
    draw = raycast.triangles_in_image

    def noted(vertices, faces, camera, pose):
        sizes.append(camera.width)
        return draw(vertices, faces, camera, pose)

    monkeypatch.setattr(raycast, "triangles_in_image", noted)
    large = PinholeCamera.from_size(256, LARGE // 256)
    pose = look_along(np.array([1.0, 1.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    for name in ("auto", "raycast"):
        for camera in (large, large.resized(255, LARGE // 256)):
            make_renderer(name, box_room).render(camera, pose, supersample=1)
    assert sizes == [256]
    monkeypatch.setattr(raycast, "_MAX_FACES_PER_RAY", 11 / LARGE)  # the room has 12 triangles
    make_renderer("auto", box_room).render(large, pose, supersample=1)
    assert sizes == [256]
