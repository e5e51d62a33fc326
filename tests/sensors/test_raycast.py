import gc
import multiprocessing
import pickle
import weakref
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.scenes.scene import Scene
from activestructure_gym.sensors import raycast
from activestructure_gym.sensors.raycast import RaycastRenderer, default_threads
from activestructure_gym.sensors.shading import appearance_of

CAMERA = PinholeCamera.from_size(64, 37)


def box_depth(camera, world_from_camera, size):
    """Closed form: with camera rays of z = 1, the depth is the ray parameter at the nearest wall ahead."""
    u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
    directions = rays @ world_from_camera[:3, :3].T
    walls = np.where(directions > 0, size, 0.0)
    return ((walls - world_from_camera[:3, 3]) / directions).min(axis=-1)


@pytest.mark.parametrize("supersample", [1, 2, 3])
def test_depth_of_the_box_room_is_exact(box_room, room_poses, supersample):
    renderer = RaycastRenderer(box_room)
    for pose in room_poses:
        depth = renderer.render(CAMERA, pose, supersample=supersample)[1]
        assert depth.dtype == np.float32
        assert np.abs(depth - box_depth(CAMERA, pose, (4.0, 3.0, 2.5))).max() < 1e-5


def test_depth_does_not_depend_on_the_colour_samples(cluttered_room, room_poses):
    renderer = RaycastRenderer(cluttered_room, threads=2)
    depths = [renderer.render(CAMERA, room_poses[0], supersample=s)[1] for s in (1, 2, 3, 4)]
    assert all(np.array_equal(depths[0], other) for other in depths[1:])


def test_a_texture_is_seen_upright_texel_by_texel(make_quad, merge):
    # A 4 x 2 m picture, upright in the plane z = 1 of the camera (x right, y down), v = 0 at its top edge; a camera
    # of 4 x 2 pixels with f = 1 sees exactly the picture, so pixel centres fall on texel centres.
    texture = np.arange(24, dtype=np.uint8).reshape(2, 4, 3) * 10
    corners = [[-2, -1, 1], [2, -1, 1], [2, 1, 1], [-2, 1, 1]]
    mesh = merge([make_quad(corners, (1, 1, 1), [[0, 0], [1, 0], [1, 1], [0, 1]], 0)], [texture])
    rgb, depth = RaycastRenderer(Scene("picture", mesh, "tests")).render(
        PinholeCamera(4, 2, 1.0, 1.0, 2.0, 1.0), np.eye(4), supersample=1
    )
    np.testing.assert_array_equal(rgb, texture)
    np.testing.assert_allclose(depth, 1.0, atol=1e-6)


@pytest.mark.parametrize(("camera_x", "depth"), [(-0.1, 0.0), (0.1, 1.0)])
def test_two_by_two_samples_are_averaged_but_not_their_depths(make_quad, merge, camera_x, depth):
    # White from x = 0 to the right in the plane z = 1, nothing to the left. One pixel with f = 2 covers 0.5 m there,
    # its samples lie 0.125 m left and right of the camera: two of four hit, 255 * 2 / 4 = 127.5 -> 128. The depth is
    # that of the central ray alone: nothing from 0.1 m left of the edge, 1 m from 0.1 m right of it.
    mesh = merge([make_quad([[0, -9, 1], [9, -9, 1], [9, 9, 1], [0, 9, 1]], (1, 1, 1), np.zeros((4, 2)), -1)])
    pose = np.eye(4)
    pose[0, 3] = camera_x
    rgb, got = RaycastRenderer(Scene("half", mesh, "tests")).render(
        PinholeCamera(1, 1, 2.0, 2.0, 0.5, 0.5), pose, supersample=2
    )
    assert rgb.tolist() == [[[128, 128, 128]]]
    assert got[0, 0] == pytest.approx(depth, abs=1e-6)


def test_nothing_ahead_is_black_with_depth_0(box_room):
    outside = np.eye(4)
    outside[:3, 3] = (0, 0, 50)
    rgb, depth = RaycastRenderer(box_room).render(CAMERA, outside)
    assert not rgb.any() and not depth.any()


def test_result_does_not_depend_on_threads_or_bands(cluttered_room, room_poses, monkeypatch):
    camera = PinholeCamera.from_size(200, 150)
    expected = RaycastRenderer(cluttered_room, threads=1).render(camera, room_poses[1])
    renderer = RaycastRenderer(cluttered_room, threads=3)
    for rays in (1, 16_000, 10**9):  # a row at a time, the default, the whole image
        monkeypatch.setattr(raycast, "_RAYS_PER_BAND", rays)
        for got, want in zip(renderer.render(camera, room_poses[1]), expected):
            np.testing.assert_array_equal(got, want)


def test_one_renderer_serves_several_threads(cluttered_room, room_poses):
    renderer = RaycastRenderer(cluttered_room, threads=2)
    expected = [renderer.render(CAMERA, pose) for pose in room_poses]
    with ThreadPoolExecutor(4) as pool:
        got = list(pool.map(lambda pose: renderer.render(CAMERA, pose), room_poses))
    for one, other in zip(expected, got):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])


def test_pickle_gives_the_same_pictures(cluttered_room, room_poses):
    renderer = RaycastRenderer(cluttered_room, threads=2)
    expected = renderer.render(CAMERA, room_poses[2])
    copy = pickle.loads(pickle.dumps(renderer))
    for got, want in zip(copy.render(CAMERA, room_poses[2]), expected):
        np.testing.assert_array_equal(got, want)


def test_works_in_a_forked_child(cluttered_room, room_poses):
    # A pool's threads do not exist in the child; waiting for them would last for ever.
    renderer = RaycastRenderer(cluttered_room, threads=2)
    camera = PinholeCamera.from_size(160, 90)
    expected = renderer.render(camera, room_poses[0])[1].sum()
    assert renderer._pool is not None
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=lambda: queue.put(renderer.render(camera, room_poses[0])[1].sum()))
    child.start()
    try:
        assert queue.get(timeout=20) == expected
    finally:
        child.kill()
        child.join()


def test_scene_data_are_shared_and_let_go(box_room):
    scene = Scene("copy", box_room.mesh, "tests")
    appearance = appearance_of(scene)
    assert appearance_of(scene) is appearance
    for name in ("faces", "colors", "uv", "face_texture"):
        assert np.shares_memory(getattr(appearance, name), getattr(scene.mesh, name)), name
    gone = weakref.ref(appearance.texels)
    del scene, appearance
    gc.collect()
    assert gone() is None


def test_closing_twice_is_allowed_and_drawing_again_too(box_room, room_poses):
    renderer = RaycastRenderer(box_room)
    camera = PinholeCamera.from_size(160, 90)
    first = renderer.render(camera, room_poses[0])[0]
    renderer.close()
    renderer.close()
    np.testing.assert_array_equal(renderer.render(camera, room_poses[0])[0], first)


@pytest.mark.parametrize("wrong", [{"threads": 0}, {"supersample": 0}])
def test_counts_below_one_are_refused(box_room, wrong):
    with pytest.raises(ValueError, match=f"{next(iter(wrong))} must be at least 1, got 0"):
        RaycastRenderer(box_room, threads=wrong.get("threads", 1)).render(
            CAMERA, np.eye(4), supersample=wrong.get("supersample", 1)
        )


def test_one_thread_where_the_environment_says_so(monkeypatch):
    for text, expected in (("1", 1), ("2", 2), ("8", 2), ("", 2)):
        monkeypatch.setenv("OMP_NUM_THREADS", text)
        assert default_threads() == expected
